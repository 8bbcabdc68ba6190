"""Where samples come from when not from the bus; a new kind is one file, ``*_source.py``."""
