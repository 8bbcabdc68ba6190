"""Faults of samples, of the tracks and of the cycle count, on random motions, compared with the truth."""
