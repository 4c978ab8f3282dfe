"""A sandbox for submissions: a child process with limits on time, memory and files."""
