"""User-defined worlds: physics engines such as MuJoCo, forces as functions, obstacles that move."""
