"""Child processes: how they start, how they are watched, and how they end. Nobody else starts one."""
