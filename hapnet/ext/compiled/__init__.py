"""Whole scenarios under any of the couplings, compiled by numba, each kind on its own (kinds.py).

The equations are those of `control`, `couplings`, `plant`, `mechanics` and `wire`: functions over records, of which
twins.py makes compiled twins. What is here is the order in which a scenario calls them, and its link.
"""
