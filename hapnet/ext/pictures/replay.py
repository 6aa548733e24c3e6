"""A replay beside its original."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hapnet.ext.pictures.style import COLOURS, legend_above, sheet
from hapnet.recording.hand import hand_times
from hapnet.recording.poses import of_point
from hapnet.recording.samples import Recording
from hapnet.units import units_in, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(original: Recording, again: Recording) -> Figure:
    """The device's position and the force on it, the original dashed, along the axis that moved most."""
    original, again = of_point(original), of_point(again)
    assert original.device is not None
    axis = int(np.ptp(original.device["position_m"], axis=0).argmax())
    unit = units_in(original.meta, original.device["position_m"].shape[1])[axis]
    with sheet(110) as fig:
        panels = fig.subplots(2, 1, sharex=True)
        for panel, name, scale, label in (
            (panels[0], "position_m", 1e3, f"device's position [{within(unit, 'mm')}]"),
            (panels[1], "force_N", 1.0, f"force on the device [{within(unit, 'N')}]"),
        ):
            for run, said, style in (
                (again, "replay", {"color": COLOURS[5], "linewidth": 2.2}),
                (original, "original", {"color": "black", "linestyle": "--", "linewidth": 0.9}),
            ):
                assert run.device is not None
                values = run.device[name]
                if axis < values.shape[1]:
                    panel.plot(hand_times(run), values[:, axis] * scale, label=said, **style)
            panel.set_ylabel(label)
        legend_above(panels[0])
        panels[1].set_xlabel("time since control started [s]")
    return fig
