"""``canfb calibrate``: reference measurement, upload of the table, verification, report."""
