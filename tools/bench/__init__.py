"""Benchmarks: time of a cycle and of whole arrays, latency on a bus."""
