"""Whole scenarios under PSPM or the plain virtual coupling, compiled by numba.

The equations are those of `control`, `plant`, `mechanics` and `wire`: functions over records, of which twins.py makes
compiled twins. What is here is the order in which a scenario calls them, and its link.
"""
