"""Layer setting services (CiA 305): node-ID and bit rate over the bus."""
