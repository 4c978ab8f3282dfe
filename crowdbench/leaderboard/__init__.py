"""The leaderboard: submissions, their verification, and the pages that show them.

A submission is a folder, or its zip, that is not trusted: neither its numbers nor its files.
crowdbench rolls it out itself, scores it and writes an entry; the pages are made of entries alone.
"""
