"""The documentation site: pages, their order, what is made of the code, and the check of the result."""
