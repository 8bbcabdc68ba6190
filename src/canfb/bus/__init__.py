"""Real buses: clock, sockets, and the runner of any device."""
