"""Time of each frame: one clock for SYNC, one judge. Pure arithmetic.

Nothing here knows CAN, a clock or a file: receive times and counters come as arguments.
"""
