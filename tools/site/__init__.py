"""The documentation site: pages, their order, and what is made of the code."""
