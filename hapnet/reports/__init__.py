"""What people look at after a run: figures, the summary as tables, and both on one page."""
