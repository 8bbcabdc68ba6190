"""The page of ``canfb scope``: what it shows, who may see it, what it lets do; no clock or socket."""
