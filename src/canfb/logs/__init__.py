"""What the replay of bus logs gives: one log or a folder of them, and files."""
