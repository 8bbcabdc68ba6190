"""What is wrong on a bus: its nodes, its frames in words, and why a position is lost."""
