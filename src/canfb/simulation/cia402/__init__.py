"""A simulated drive (CiA 402) and the motor that it turns, with the feedback module as its encoder."""
