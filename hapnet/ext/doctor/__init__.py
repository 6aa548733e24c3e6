"""Checks of what a machine and its network allow a servo and its messages."""
