"""Virtual worlds: their protocol (the arguments and results of a step), walls, and the registry of names."""
