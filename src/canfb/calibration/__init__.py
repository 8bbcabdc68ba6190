"""Reference measurements: recorded tracks in, a correction table and how good it is out.

recording -> ellipse -> solver (joint) -> methods -> result: drift; deviation: proof;
over_speeds: several of them -> path_fit: delays and corners of the analog path
"""
