"""Replay of a bus log, or a folder of them, and files of the results."""
