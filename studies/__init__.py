"""Studies: what the pages of results say, and how it was measured. They need a clone.

Run them as `python -m studies NAME` in the root of the repository; nothing that is installed
imports them.
"""
