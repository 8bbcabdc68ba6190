"""Reference measurements: recorded tracks in, a correction table and how good it is out.

Two methods, one result (:class:`canfb.calibration.result.Calibration`)::

    zero_crossing   section 2 of the paper: slow motion, 40 and more samples in each cycle
    from_motion     any motion, also many cycles per sample; sampled with SYNC

Both refuse a bad measurement with :class:`canfb.errors.CalibrationError`. Nothing here knows
CAN, a clock or a file. The parts::

    recording -> ellipse -> following -> solver (blocks, joint) -> from_motion -> result
                                 waveform: tracks over the phase -> correction table
    deviation: the proof on other samples, drift from a table
    over_speeds: several of them -> path_fit: delays and corners of the analog path
"""
