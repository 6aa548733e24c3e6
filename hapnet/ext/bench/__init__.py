"""`hapnet bench`: what this project costs on this machine, each figure beside a bare reference from the same run.

`row.py` defines a result, `registry.py` lists the rows; every other module measures one subject.
"""
