"""How the suite is run: its package, its lowest versions, and whether it notices changes of the code."""
