"""Bilateral laws between a leader and a robot that follows it; each file is a law, see `hapnet.laws`."""
