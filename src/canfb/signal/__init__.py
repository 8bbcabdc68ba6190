"""The signal chain: pure arithmetic from ADC counts to a supervised position.

Nothing here knows CAN, a clock or a file. One sample flows through the modules in
this order::

    chain, sample_times -> stages: conditioning -> phase -> correction -> supervision -> tracker, estimator
"""
