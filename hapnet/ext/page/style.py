"""A style sheet for settings that viser's page has no option for."""

from __future__ import annotations

STYLE = """<style>
/* viser shows the scene at 5 % until the picture that lights it has come */
canvas { opacity: 1 !important; }
/* grey in a second, unless it is drawn anew: each drawing has the other name, with which the time begins again */
@keyframes hapnet-old-0 { to { filter: grayscale(1) opacity(0.5); } }
@keyframes hapnet-old-1 { to { filter: grayscale(1) opacity(0.5); } }
.hapnet-drawn-0 { animation: hapnet-old-0 1ms linear 1s forwards; }
.hapnet-drawn-1 { animation: hapnet-old-1 1ms linear 1s forwards; }
.hapnet-old { filter: grayscale(1) opacity(0.5); }
/* on a telephone: the sheet at the bottom takes less than half, and the scene is drawn above it */
@media (max-width: 36em) {
  [style*="max-height: 60%"] { max-height: 44% !important; }
  [style*="width: 20em"] { width: 100% !important; }
  div[style*="z-index: 0; width: 100%; height: 100%"] { height: 56% !important; }
}
</style>"""
"""The selectors name inline styles of viser 1.1; where another version has others, nothing is lost but this."""
