"""When people enter: processes of arrivals."""
