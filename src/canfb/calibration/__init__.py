"""Reference measurements: recorded tracks in, a correction table and how good it is out."""
