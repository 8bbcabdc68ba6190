"""Campaigns of faults in the samples and on the wire, which compare the module with the truth."""
