"""The drive feedback module: the CiA 406 encoder profile over a signal chain."""
