"""Scenarios: changes of arrivals, and models under them."""
