"""Definitions of CiA 301 that every layer may use: frames, COB-IDs, data types, NMT states, codes."""
