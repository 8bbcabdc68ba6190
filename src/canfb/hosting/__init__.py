"""Nodes of a configuration on a real bus: sources, state files, real time, logs, readiness."""
