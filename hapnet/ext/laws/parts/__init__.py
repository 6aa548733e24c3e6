"""Parts that several of these laws are made of."""
