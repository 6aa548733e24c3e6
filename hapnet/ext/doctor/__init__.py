"""Checks of whether machine, network and device are good enough for a servo and its messages."""
