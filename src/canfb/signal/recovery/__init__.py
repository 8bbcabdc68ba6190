"""From a bad sample until the position is certain again, or lost; coarse track and zero pulse."""
