"""From parameters to the parts of a run: devices, hands, worlds, sides."""
