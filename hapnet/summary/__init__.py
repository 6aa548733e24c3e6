"""What a run's summary says, and its verdict."""
