"""Examples that are programs of their own; each has a README."""
