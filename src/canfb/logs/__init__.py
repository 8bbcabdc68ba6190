"""Bus logs as files: one of them or a folder through replayed modules, and what came out as files."""
