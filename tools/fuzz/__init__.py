"""Plays inputs of a fuzzer to the devices and the readers of files."""
