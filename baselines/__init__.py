"""Policies to learn from, one readable file each."""
