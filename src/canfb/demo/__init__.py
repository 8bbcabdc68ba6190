"""The whole story on an embedded bus: start, track, calibrate, upload, verify, survive faults."""
