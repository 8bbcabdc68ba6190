"""Where samples come from when not from the bus; a new kind is one file.

protocol        what a source is, its configuration, and the kinds: every ``*_source.py`` of this folder
even_scans      the samples of a SYNC from the scans of a faster converter
tracks_file     both tracks out of an NPZ file
"""
