"""What takes how long, and how good it is: cycles, modules, latency, correction tables."""
