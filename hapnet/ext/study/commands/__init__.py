"""The commands that make many runs alike: `hapnet compare`, `sweep`, `tune` and `transparency`."""
