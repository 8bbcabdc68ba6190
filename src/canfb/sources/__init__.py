"""Sources of samples other than the bus; each kind is one file, ``*_source.py``."""
