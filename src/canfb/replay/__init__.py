"""Recorded frames through the same module: what it publishes, which faults, with which margins; no clock."""
