"""EDS files against CiA 306 and CiA 301."""
