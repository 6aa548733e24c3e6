"""Virtual worlds: their protocol (what a world receives and returns in a step), and one file per world."""
