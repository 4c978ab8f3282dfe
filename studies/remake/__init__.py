"""`make results`: bring every generated file of the repository up to date, and nothing twice.

`declared` lists the results with what they are made from and how, `graph` decides which of them are
stale and makes them, and `results.lock` holds what the files in the repository were made from.
"""
