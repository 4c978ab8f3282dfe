"""`ntpp-paper`: the founding paper's model, to the letter."""
