"""Studies that write the documentation's pages of results, figures and measurements."""
