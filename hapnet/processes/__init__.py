"""Child processes: how they start, are watched, and end. No other package starts one."""
