"""The commands: options, a call, output. The commands of one task are in one file."""
