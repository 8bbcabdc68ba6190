"""Days of operation in simulated time, with all kinds of disturbances of a bus."""
