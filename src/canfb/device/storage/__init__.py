"""Stored parameters: what is kept, as which bytes, and how it comes back (1010h, 1011h)."""
