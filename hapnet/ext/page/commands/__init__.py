"""The commands about the live page: `hapnet play`, `hapnet view` and `hapnet bridge`."""
