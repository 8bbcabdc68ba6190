"""Inputs of a fuzzer, played to the devices."""
