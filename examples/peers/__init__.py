"""Models of other simulators as policies of crowdbench; see README.md."""
