"""A simulated plant: encoder, motion, converter, faults, and the encoder interface as a CANopen node."""
