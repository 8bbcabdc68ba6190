"""The page of modules in a browser."""
