"""The page of modules in a browser: what it is drawn from, and the server that shows it."""
