"""What equations are written in, so that Python runs them and numba compiles them: records, vectors, `equation`."""
