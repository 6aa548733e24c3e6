"""The couplings by name: the two ends of each, its tuning, and the delays it is tuned for."""
