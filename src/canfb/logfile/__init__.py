"""Bus logs as files: written, and read in any format."""
