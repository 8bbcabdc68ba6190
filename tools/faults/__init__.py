"""Faults of the signal chain, of the wire and of saving, and what the module makes of them."""
