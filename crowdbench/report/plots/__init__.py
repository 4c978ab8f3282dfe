"""Pictures of crowds beside the recording: their data, and functions that draw them onto axes."""
