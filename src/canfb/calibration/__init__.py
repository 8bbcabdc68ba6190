"""Reference measurements: from recorded tracks to a correction table and its quality.

recording -> ellipse -> solver (joint) -> methods -> result (with drift); deviation: verification;
over_speeds: measurements at several speeds -> path_fit: delays and corners of the analog path
"""
