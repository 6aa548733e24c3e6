"""The protocol: bytes and the time in, events and bytes out. No clock, no I/O, no randomness of its own."""
