"""Correction tables: as files, as they stand in a module, and what ``canfb table`` does with them."""
