"""What goes wrong at the extremes, counted: every structure and both precisions beside Mitsuba with Embree."""
