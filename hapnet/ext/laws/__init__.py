"""The couplings that hapnet has beside PSPM: a file for each."""
