"""The encoder interface as a CANopen node: ADC counts of any source, one sample for each SYNC."""
