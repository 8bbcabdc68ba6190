"""Tools on the code and its tests: size, architecture, package, mutation testing."""
