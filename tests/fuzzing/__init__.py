"""Mutated messages against the decoder and both endpoints: README.md in this folder says how to run it."""
