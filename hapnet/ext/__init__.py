"""The extensions: what a run at a flat wall does not need. The core imports none of them."""
