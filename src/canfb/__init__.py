"""CANopen drive feedback module: sine/cosine encoder tracks in, a supervised position out."""
