"""Where samples come from when not from the bus; a new kind is one file.

protocol        what a module asks for its samples
surroundings    what a source may ask of the program around it
source_config   ``source:`` of a module, the base of all kinds
source_watch    asks a source at each SYNC, whatever it does
registry        finds the kinds: every ``*_source.py`` of this folder
"""
