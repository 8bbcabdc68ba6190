"""Kills in the middle of a save, and damaged files."""
