"""Submissions rolled out and scored anew, and the entries that come of it."""
