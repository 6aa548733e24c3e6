"""The process that compiles for another one, which goes on with plain Python: see `background`."""

from hapnet.ext.compiled.background import serve

serve()
