"""The cycle count after a fault: every kind of fault on random motions, held against exact feasibility."""
