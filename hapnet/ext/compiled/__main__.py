"""A process that compiles in the background while its parent runs plain Python: see `background`."""

from hapnet.ext.compiled.background import serve

serve()
