"""Studies: many runs in virtual time with the same measures, to compare couplings or to vary parameters."""
