"""What people do between entry and exit: companions, stops, via points."""
