"""One complete side of the coupling, without I/O; both runtimes drive it."""
