"""Tools: a handle that turns as well as moves, and its contacts."""
