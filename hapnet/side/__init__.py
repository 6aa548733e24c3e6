"""One side of the coupling, complete and without I/O: what both runtimes drive."""
