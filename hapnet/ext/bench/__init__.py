"""`hapnet bench`: measures the cost of hapnet on this machine, each figure beside a bare reference from the same run.

`row.py` defines a result, `registry.py` lists the rows; each of the other modules measures one subject.
"""
