"""Compiles whole scenarios under any of the couplings with numba, each kind of scenario separately (kinds.py).

The equations are those of `control`, `couplings`, `plant`, `mechanics` and `wire`: functions over records, of which
twins.py makes compiled twins. This package adds the order in which a scenario calls them, and its link.
"""
