"""`joint-gmm`: one network for the arrivals at all areas of a scene."""
