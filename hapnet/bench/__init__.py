"""`hapnet bench`: what this project costs on this machine, each figure beside a bare reference of the same run.

`row.py` says what a result is, `registry.py` lists the rows; every other module measures one subject.
"""
