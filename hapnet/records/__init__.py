"""The language of equations that Python runs and numba compiles: records, vectors, `equation`."""
