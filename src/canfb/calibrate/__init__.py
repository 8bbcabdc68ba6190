"""``canfb calibrate``: reference measurement, upload of its table, proof, report.

From ``canfb.master`` come samples and objects of a node, from ``canfb.sdo`` the files of tables::

    choices              what it is asked to do; options that exclude each other
    calibration_run      from the first sample to the last file
    speed_run            the same at several speeds
    own_calibration      the module's own reference measurement, object 2030h
    measurement          samples in, a table out, compared with the one before; at one speed or several
    samples_through_chain  the chain of the module on samples, and how far the position is off at each speed
    drift_check          how far an encoder has moved away from its table
    procedure            table activated, verified and saved
    calibration_summary  figures for people and programs; calibration_page: the page, from canfb.report
    artefacts            the files of a measurement
"""
