"""How the suite is run: its package, and whether it notices changes of the code."""
