"""Many scenarios at once: every seed or link is a column of arrays, every event one numpy call for all that have it.

The results are those of `hapnet.simulate` one at a time: bit for bit with one degree of freedom, to rounding with more.
"""
