"""`ntpp-gmm`: neural temporal point processes."""
