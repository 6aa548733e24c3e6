"""What viser's page has no option for, as a style sheet."""

from __future__ import annotations

STYLE = """<style>
/* viser shows the scene at 5 % until the picture that lights it has come */
canvas { opacity: 1 !important; }
/* on a telephone: the sheet at the bottom takes less than half, and the scene is drawn above it */
@media (max-width: 36em) {
  [style*="max-height: 60%"] { max-height: 44% !important; }
  [style*="width: 20em"] { width: 100% !important; }
  div[style*="z-index: 0; width: 100%; height: 100%"] { height: 56% !important; }
}
</style>"""
"""The selectors name inline styles of viser 1.1; where another version has others, nothing is lost but this."""
