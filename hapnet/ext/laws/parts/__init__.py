"""What several of these laws are made of."""
