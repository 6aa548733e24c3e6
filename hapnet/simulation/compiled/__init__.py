"""Runs a simulation on the compiled kernel (`hapnet.kernel`): reads its state once the handshake is over, and writes it
back at the end. What comes before and after is done by the reference itself.
"""
