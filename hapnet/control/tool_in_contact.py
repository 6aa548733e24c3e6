"""Limits the world's y while a tool touches something (ours).

A hand pushes the device far beyond the place where its spring saturates. A spring at the world that is as long lends
tens of millijoules to the tool, and each edge that it slips off dissipates a part. So y stays near the tool.

A hand that levers a tool is stopped and turned by the solids. A prediction of its motion leads past them, and what the
tool then dissipates is energy that the hand has not put in. So the longer the tool touches something, the less far the
hand's motion is predicted. In free space the tool is carried (`hapnet.control.carrying`), and its lag matters little.
"""

from __future__ import annotations

from math import dist

from hapnet.checks import Vector
from hapnet.control.predicted_device import PredictedDevice
from hapnet.records.record import Floats

FADE_S = 0.1
"""In contact for so long, the hand's motion is not predicted; after as long without contact, it is in full [s]."""


class ToolInContact:
    """Limits y for a tool that touches something.

    stretch_m : y is at most this far from the tool [m].
    """

    def __init__(self, stretch_m: float) -> None:
        self.stretch_m = stretch_m

    def predict_less(self, dt: float, touches: bool, predicted: PredictedDevice) -> None:
        """Set the share of the time to predict, `dt` seconds after the last step began.

        touches : whether a force acted on the tool in the last step.
        """
        change = dt / FADE_S
        predicted.share = max(0.0, predicted.share - change) if touches else min(1.0, predicted.share + change)

    def keep_near(self, x: Vector, y: Floats) -> None:
        """Move y (n,) [m] towards the tool at x (n,) [m] if it is too far from it."""
        if (far := dist(y, x)) > self.stretch_m:
            share = self.stretch_m / far
            y[:] = [a + share * (b - a) for a, b in zip(x, y, strict=True)]
