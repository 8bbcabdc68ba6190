"""``canfb calibrate``: reference measurement, upload of its table, proof, report."""
