"""The master's side of tools: a node's objects by SDO, samples over the bus, changes that are undone.

``access.Master`` is what it needs of a bus; ``access.NodeAccess`` reads and writes the objects of a node.
"""
