"""All figures, drawn with matplotlib, which is loaded when a figure is drawn: a module for each figure."""
