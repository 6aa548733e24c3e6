"""Studies: many runs in virtual time, measured alike: couplings against each other, parameters over ranges."""
