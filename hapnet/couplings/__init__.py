"""The couplings by name: what each is, how it is tuned, and for which delays."""
