"""Real buses: the only place with a clock, a thread or a socket."""
