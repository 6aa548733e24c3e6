"""How a run's result is drawn, and shown in a notebook."""

from __future__ import annotations

from hapnet.ext.pictures.notebook import html as html
from hapnet.ext.pictures.run import figure as figure
from hapnet.ext.pictures.style import also_to as also_to
