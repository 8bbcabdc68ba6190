"""Faults of time and of the wire: frame by frame through the whole module."""
