"""Programs that measure hapnet: ``python -m tests.measure`` lists them, ``python -m tests.measure NAME`` runs one."""
