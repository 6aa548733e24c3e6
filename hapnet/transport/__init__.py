"""Zenoh: keys, configuration, security, and why nobody answers. Nothing else knows it."""
