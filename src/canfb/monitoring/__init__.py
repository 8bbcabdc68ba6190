"""Modules as a bus shows them: frames and times in, snapshots out."""
