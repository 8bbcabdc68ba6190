"""The object dictionary: entries, EDS and DCF files, and the order in which values can be written."""
