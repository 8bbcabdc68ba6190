"""The master's side of tools: objects by SDO, samples, changes that are undone."""
