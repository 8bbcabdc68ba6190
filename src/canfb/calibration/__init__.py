"""Reference measurements: recorded tracks in, a correction table and how good it is out.

Without CAN, a clock or a file::

    recording -> ellipse -> solver (blocks, joint) -> from_motion -> result
                                 waveform: tracks over the phase -> correction table
    deviation: the proof on other samples, drift from a table; changes: tracks that change meanwhile
    over_speeds: several of them -> path_fit: delays and corners of the analog path
"""
