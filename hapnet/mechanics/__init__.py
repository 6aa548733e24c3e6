"""Potentials and projections that control and the simulated plant share: springs, ellipsoids."""
