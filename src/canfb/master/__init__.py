"""Tools as master of the bus: objects by SDO, samples, changes with undo."""
