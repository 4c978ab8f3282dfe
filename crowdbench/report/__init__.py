"""What people look at: plots, the HTML report, and text in plain words."""
