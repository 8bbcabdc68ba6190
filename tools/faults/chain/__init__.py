"""Faults of the samples: through the signal chain."""
