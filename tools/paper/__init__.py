"""Checks the claims of the paper one by one."""
