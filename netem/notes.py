"""What a user should know about how netem reads the text of a link."""

from __future__ import annotations

from netem import tc


def notes(text: str) -> list[str]:
    """A sentence for each thing that netem assumes in reading the text of a profile. The text was read before."""
    return tc.left_out(text)
