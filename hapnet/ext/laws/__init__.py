"""hapnet's couplings other than PSPM, one file each."""
