"""Nodes of a configuration on a real bus."""
