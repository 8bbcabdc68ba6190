"""Faults of samples, of the tracks and of the cycle count: each kind on random motions, against the truth."""
