"""Example policies, one readable file each."""
