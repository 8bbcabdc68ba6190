"""What goes on in modules on a bus, seen from outside: frames and times in, snapshots out."""
