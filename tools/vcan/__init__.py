"""A SocketCAN interface vcan0 on any Linux."""
