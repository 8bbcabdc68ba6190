"""The page of ``canfb scope``: what it shows, who may see it, its tasks, and its server."""
