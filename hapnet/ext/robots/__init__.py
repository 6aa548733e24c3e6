"""Follower robots, and the drivers of robots."""
