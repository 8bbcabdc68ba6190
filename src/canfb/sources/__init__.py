"""Where samples come from when not from the bus: one file for each kind of source."""
