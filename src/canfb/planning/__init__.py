"""What a bit rate, a SYNC rate, an encoder and a motion allow: pure arithmetic over a module, its interface
and a motion."""
