"""Whole scenarios under PSPM or the plain virtual coupling, in functions that numba compiles.

Each file is named after the file of the reference whose equations it mirrors, in the same order of operations: so one
axis gives the same bits. The reference stays the place where an equation is explained.
"""
