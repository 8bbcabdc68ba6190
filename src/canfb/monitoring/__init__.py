"""Observation of modules on a bus: frames and times in, snapshots out."""
