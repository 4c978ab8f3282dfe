"""Text that pages share: numbers in words, Markdown."""
