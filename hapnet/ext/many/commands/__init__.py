"""The commands of graphs and seats."""
