"""Soft bodies as worlds."""
