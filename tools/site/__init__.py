"""The documentation site: pages, their order, and the pages generated from the code."""
