"""The commands: each parses options, makes a call and prints. The commands of one task are in one file."""
