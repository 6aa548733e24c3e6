"""Axes in radians: who declares them, who must agree, and where they show."""

import csv
from pathlib import Path
from typing import Any

import pytest

from hapnet.assembly.build import device_session, device_side, prepare, world_session
from hapnet.errors import InvalidParameter
from hapnet.ext.pictures.run import figure
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from hapnet.recording.export import export
from hapnet.recording.mcap import RecordingWriter, read_recording
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.simulation.simulation import simulate
from hapnet.summary.recorded import from_recording
from hapnet.summary.structure import read
from hapnet.summary.tables import brief, motion
from hapnet.units import text_of, units_of, within
from hapnet.wire.events import Mismatch, Paired
from tests.support.sessions import MS, Network

HERE = "tests.test_units"


def hinge(position: Any, velocity: Any, time: float) -> list[float]:
    """A spring on an axis in metres and one in radians."""
    return [-40.0 * position[0], -0.5 * position[1]]


hinge.units = "m,rad"  # type: ignore[attr-defined]


def wrong(position: Any, velocity: Any, time: float) -> list[float]:
    return [0.0, 0.0]


wrong.units = "m,deg"  # type: ignore[attr-defined]


class Straight(SimulatedDevice):
    """Says nothing, so its axes are in metres."""

    def __init__(self, dof: int) -> None:
        super().__init__(Rest(dof, Impedance()))


class Hinge(Straight):
    units = "m,rad"


def params(**more: object) -> Params:
    own = {"scene": f"{HERE}:hinge", "dof": 2, "operator": "sine", "duration_s": 0.5, "rendering": "paper"}
    return Params().set({**own, **more})


def test_a_text_says_the_unit_of_each_axis() -> None:
    assert units_of("rad", 3) == ("rad", "rad", "rad")
    assert units_of("m, m,rad", 3) == ("m", "m", "rad")
    assert text_of(("m", "rad")) == "m,rad"
    assert text_of(("rad", "rad")) == "rad"
    for bad in ("deg", "", "m,rad", 1, None):
        with pytest.raises(InvalidParameter, match=r"^units is .*m or rad, for all axes or one for each of 3"):
            units_of(bad, 3)
    assert [within("rad", unit) for unit in ("mm", "N", "N/m", "m/s", "mJ")] == ["mrad", "Nm", "Nm/rad", "rad/s", "mJ"]
    assert within("m,rad", "N") == "N or Nm"
    assert within(None, "mm") == "mm"


def test_the_world_says_them_and_the_parameters_follow() -> None:
    assert prepare(params()).params.units == "m,rad"
    assert prepare(params(units="m,rad")).units == "m,rad"
    assert prepare(Params()).params.units == "auto"
    with pytest.raises(InvalidParameter, match=r"^units is 'rad'; allowed: auto or m,rad"):
        prepare(params(units="rad"))
    with pytest.raises(InvalidParameter, match=r"units is 'm,deg'; allowed: m or rad"):
        prepare(params(scene=f"{HERE}:wrong"))


def test_a_device_with_others_is_refused() -> None:
    for name, fits in (("Hinge", True), ("Straight", False)):
        setup = prepare(params(hardware=f"{HERE}:{name}").unset("operator"), "sampled")
        endpoint = DeviceEndpoint(device_session(setup, 1))
        if fits:
            device_side(setup, endpoint, lambda: 0, lambda _: None)
            continue
        with pytest.raises(InvalidParameter, match=r"a device with axes in m,rad; this one's are in m$"):
            device_side(setup, endpoint, lambda: 0, lambda _: None)


def test_sides_with_different_units_refuse_each_other_in_one_line() -> None:
    flat = prepare(Params().set({"scene": "free", "dof": 2, "coupling": "pspm", "rendering": "paper"}))
    turned = prepare(params())
    network = Network(device_session(flat, 1, "pen"), world_session(turned, 2, "hinge"))
    network.run(1000 * MS)
    told = [e.reason for s in network.sessions for e in network.happened(s, Mismatch) if isinstance(e, Mismatch)]
    assert set(told) == {
        "hinge has axes in m,rad, pen in m: both must have the same",
        "pen has axes in m, hinge in m,rad: both must have the same",
    }
    assert all(s.peer is None for s in network.sessions)
    alike = Network(device_session(turned, 1), world_session(turned, 2))
    alike.run(1000 * MS)
    assert all(alike.happened(s, Paired) for s in alike.sessions)


def test_recordings_tables_and_figures_carry_them(tmp_path: Path) -> None:
    result = simulate(params(), 3)
    assert result.summary["units"] == "m,rad"
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, result.recording.meta)
    for sample in result.recording.samples():
        writer.write(sample)
    writer.close(None)
    again = read_recording(path)
    for side in ("device", "world"):
        for name, values in getattr(result.recording, side).items():
            assert getattr(again, side)[name].tobytes() == values.tobytes(), name
    assert from_recording(again)["units"] == "m,rad"
    with export(again, tmp_path, format="csv")[0].open(encoding="utf-8") as file:
        columns = next(csv.reader(file))
    wanted = {"position_m_x", "position_rad_y", "velocity_mps_x", "velocity_radps_y", "force_N_x", "force_Nm_y"}
    assert wanted <= set(columns)
    assert not {"position_m_y", "force_N_y"} & set(columns)
    summary = read(result.summary)
    assert any("[mm or mrad]" in label for label, *_ in motion(summary).rows)
    assert any("mm or mrad free" in line for line in brief(summary))
    turned = simulate(Params().set({"scene": f"{HERE}:twisted", "duration_s": 0.5, "rendering": "paper"}), 3)
    labels = [panel.get_ylabel() for panel in figure(turned.recording).axes]
    assert labels[:2] == ["rotation [°]", "torque [Nm]"]


def twisted(position: Any, velocity: Any, time: float) -> float:
    return -0.5 * float(position[0])


twisted.units = "rad"  # type: ignore[attr-defined]
