"""SYNCs on their grid, and the ADC PDOs that answer them. Pure arithmetic.

Nothing here knows CAN, a clock or a file: receive times and counters are arguments.
"""
