"""Objects of a node by name: what ``canfb sdo`` reads and writes."""
