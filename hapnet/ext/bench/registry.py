"""The rows of `hapnet bench` by name, in the order of measurement and display."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from functools import partial

from hapnet.errors import InvalidParameter
from hapnet.ext.bench.control import device_tick, pspm_update
from hapnet.ext.bench.latency import one_way_latency, one_way_latency_realtime
from hapnet.ext.bench.mesh import world_step_mesh
from hapnet.ext.bench.page import page_mesh
from hapnet.ext.bench.plants import arm_tick, batch_1000, handle_tick, side_tick_joints, side_tick_pose, simulate_ndof
from hapnet.ext.bench.row import Options, Row
from hapnet.ext.bench.servo import servo_busy_thread, servo_idle
from hapnet.ext.bench.traffic import RATES_KHZ, servo_traffic
from hapnet.ext.bench.watched import servo_watched
from hapnet.ext.bench.wire import codec_energy, codec_position, energy_recovery, link_release
from hapnet.ext.bench.world import integrator_step, world_step_kilohertz, world_step_wall

Measure = Callable[[Options], Row]

DIMENSIONS = (1, 2, 3, 6)
RECOVERY = [(rtt_ms, loss) for rtt_ms in (20, 80, 200) for loss in (5, 20)]

ROWS: dict[str, Measure] = {
    "servo_idle": servo_idle,
    "servo_traffic": servo_traffic,
    **{f"servo_traffic_{khz}khz": partial(servo_traffic, khz=khz) for khz in RATES_KHZ},
    "servo_watched": servo_watched,
    "page_mesh": page_mesh,
    "servo_busy_thread": servo_busy_thread,
    "device_tick": device_tick,
    "arm_tick": arm_tick,
    "handle_tick": handle_tick,
    "side_tick_pose": side_tick_pose,
    "side_tick_joints": side_tick_joints,
    **{f"pspm_update_{n}dof": partial(pspm_update, n) for n in DIMENSIONS},
    **{f"integrator_step_{n}dof": partial(integrator_step, n) for n in DIMENSIONS},
    "world_step_wall": world_step_wall,
    "world_step_kilohertz": world_step_kilohertz,
    "world_step_mesh": world_step_mesh,
    "codec_position": codec_position,
    "codec_energy": codec_energy,
    "one_way_latency": one_way_latency,
    "one_way_latency_realtime": one_way_latency_realtime,
    "link_release": link_release,
    "energy_recovery": partial(energy_recovery, 80, "2%", "energy_recovery"),
    **{
        name: partial(energy_recovery, rtt_ms, f"{loss}%", name)
        for rtt_ms, loss in RECOVERY
        for name in (f"energy_recovery_rtt{rtt_ms}_loss{loss}",)
    },
    "simulate_1dof": partial(simulate_ndof, 1),
    "simulate_3dof": partial(simulate_ndof, 3),
    "batch_1000": batch_1000,
}


def select(only: Sequence[str]) -> dict[str, Measure]:
    """The rows with these names or patterns (``pspm_*``); all if none is given.

    Raises InvalidParameter: no row has such a name.
    """
    for word in only:
        if not any(fnmatchcase(name, word) for name in ROWS):
            raise InvalidParameter("--only", word, "names of rows, or patterns: " + ", ".join(ROWS), ROWS)
    return {name: row for name, row in ROWS.items() if not only or any(fnmatchcase(name, word) for word in only)}
