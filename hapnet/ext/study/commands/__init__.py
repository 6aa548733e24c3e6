"""The commands that make many runs: `hapnet compare`, `sweep`, `tune` and `transparency`."""
