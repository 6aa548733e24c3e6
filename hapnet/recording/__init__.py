"""What is kept of a run: samples, their files, what is published while it runs, and how one is used again."""
