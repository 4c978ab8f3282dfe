"""Plots, the HTML report, and text shared by generated pages."""
