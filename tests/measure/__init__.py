"""Programs that measure hapnet itself; each is a command: ``python -m tests.measure.NAME``."""
