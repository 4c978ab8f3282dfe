"""Roll out and score submissions, and write their entries."""
