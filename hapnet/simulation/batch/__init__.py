"""Many scenarios at once: each scenario is a column of arrays, and one numpy call handles an event in all that have it.

The results are those of `hapnet.simulate` for each scenario: bit for bit with one degree of freedom, to rounding with
more.
"""
