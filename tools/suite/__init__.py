"""How the suite is run: its parts, its lowest versions, and whether it notices changes of the code."""
