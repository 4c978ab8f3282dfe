"""Text shared by the report and the generated pages: number formats and Markdown."""
