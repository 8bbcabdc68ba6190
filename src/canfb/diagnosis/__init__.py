"""Diagnosis of a bus: nodes, frames in words, why a position is lost."""
