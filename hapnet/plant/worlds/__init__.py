"""Virtual worlds: what each is asked and tells in a step (protocol), and the worlds, a file each."""
