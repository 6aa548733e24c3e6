"""Rigid tools with six degrees of freedom, and their contacts."""
