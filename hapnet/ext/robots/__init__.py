"""Robots that follow the hand, and the drivers of robots."""
