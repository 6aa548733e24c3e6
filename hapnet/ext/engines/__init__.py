"""Worlds of one's own: physics engines (MuJoCo is one), forces as functions, obstacles that move."""
