"""Absolute sensors as witnesses of the counted position: coarse track, zero pulse, second position."""
