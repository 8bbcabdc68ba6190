"""Recorded frames processed by the same module: what it publishes, faults, margins; without a clock."""
