"""Runs a simulation as compiled code: reads its state after the handshake, and writes it back at the end. Plain Python
does the rest before and after.
"""
