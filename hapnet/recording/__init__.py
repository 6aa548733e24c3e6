"""Records of a run: samples, their files, the data published while it runs, and how a run is used again."""
