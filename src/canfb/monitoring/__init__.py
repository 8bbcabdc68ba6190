"""What goes on in modules on a bus, as the bus shows them: frames and times in, snapshots out."""
