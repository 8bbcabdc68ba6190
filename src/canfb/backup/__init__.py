"""All parameters of a module as a file, and back into a module, proven."""
