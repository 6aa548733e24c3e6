"""The protocol: bytes and the time go in, events and bytes come out. No clock, no I/O, no random numbers."""
