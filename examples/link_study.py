"""Measure how much delay a coupling tolerates: a relaxed hand moves into a wall and out over links of growing delay.

python examples/link_study.py                               # a table, and runs/link_study.png
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hapnet import Params, simulate_batch

DELAYS_MS = (0, 20, 30, 40, 60, 80, 120)  # one way
COUPLING_NAMES = {"pspm": "PSPM", "zoh": "plain virtual coupling"}

RUN = {
    "rendering": "paper",  # as published: without prediction or a local contact model
    "operator": "sine",
    "operator_model.mass": 0.1,  # kg, Ns/m, N/m: relaxed fingers
    "operator_model.damping": 0.5,
    "operator_model.stiffness": 20.0,
    "operator_model.frequency_hz": 1.0,
    "duration_s": 3.25,  # ends at the sine's crest, where the hand presses into the wall
}


def study(coupling: str) -> tuple[list[float], list[float]]:
    """For each delay, over all seeds: maximum energy that came out [mJ], position error at the end (rms) [mm]."""
    links = [f"delay {delay}ms {delay / 10}ms loss 1%" for delay in DELAYS_MS]
    cases = [Params().set({**RUN, "coupling": coupling, "link.up": link, "link.down": link}) for link in links]
    runs = simulate_batch(cases, seeds=range(3))  # seeds vary fastest
    out = np.array([run.summary["theorem"]["energy_out_J"] for run in runs]).reshape(len(cases), -1)
    errors = np.array([run.device.position_m[0] - run.world.position_m[0] for run in runs]).reshape(len(cases), -1)
    return (1e3 * out.max(axis=1)).tolist(), (1e3 * np.sqrt((errors**2).mean(axis=1))).tolist()


def main() -> None:
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    top, bottom = figure.subplots(2, sharex=True)
    print(f"{'delay [ms]':>10}  {'coupling':<23}{'max. energy out [mJ]':>21}{'error at the end [mm]':>26}")
    for coupling, words in COUPLING_NAMES.items():
        out, errors = study(coupling)
        for row in zip(DELAYS_MS, out, errors, strict=True):
            print(f"{row[0]:>10}  {words:<23}{row[1]:>21.1f}{row[2]:>26.2f}")
        top.plot(DELAYS_MS, out, "o-", label=words)
        bottom.plot(DELAYS_MS, errors, "o-", label=words)
    top.axhline(150.0, color="0.3", linewidth=0.8)  # initial energy of both reservoirs
    top.set(ylabel="energy that came out, most [mJ]", title="above d² = 150 mJ: not passive")
    bottom.set(xlabel="delay, one way [ms]", ylabel="position error at the end,\nrms of all seeds [mm]")
    bottom.legend()
    Path("runs").mkdir(exist_ok=True)
    figure.savefig("runs/link_study.png", dpi=150)  # pyright: ignore[reportUnknownMemberType]
    print("runs/link_study.png")


if __name__ == "__main__":
    main()
