"""What absolute sensors say of the counted position: coarse track, zero pulse, second position."""
