"""Several hands in one world: bodies that they share, and graphs of pairs."""
