"""Runs a simulation as compiled code: reads its state once the handshake is over, and writes it back at the end. What
comes before and after is done by plain Python.
"""
