"""Days of operation in simulated time, with everything that happens to a bus in them."""
