"""Time of each frame: one clock for SYNC, one for samples, one judge. Pure arithmetic.

Nothing here knows CAN, a clock or a file: receive times, counters and sample times come as arguments.
"""
