"""Stored parameters (1010h, 1011h): the values saved, their format, the stores, and restoring."""
