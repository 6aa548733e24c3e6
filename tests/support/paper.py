"""The paper's own feel: for tests of its equations and its experiment."""

from __future__ import annotations

from hapnet.params import Params

PAPER = Params(rendering="paper")
