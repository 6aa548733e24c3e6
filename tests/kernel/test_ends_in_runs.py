"""Whole runs of a tool and of an arm joint by joint, with compiled ends and without: the same samples, bit by bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.ext.bench.plants import by_joints, seven_joints
from hapnet.ext.compiled import catalogue, real_time
from hapnet.ext.compiled.real_time import CompiledTicks
from hapnet.ext.compiled.servo_end import CompiledServo
from hapnet.params import Params
from hapnet.records.machine_code import no_compiler
from hapnet.simulation.simulation import Simulation

LINK = {"link.up": "4g", "link.down": "4g", "duration_s": 1.0}
TOOL = {"scene": "tool:box + plane?normal=0,0,-1&at=0,0,-20mm", "operator_model.turn_rad": 0.5}
PEG = {"scene": "tool:peg + hole?at=0,0,-20mm", "operator": "hand-42", "duration_s": 2.0}


@pytest.mark.skipif(no_compiler() is not None, reason="nothing can be compiled")
@pytest.mark.slow
@pytest.mark.parametrize("case", ["tool", "peg", "seven joints"])
def test_compiled_ends_give_the_same_run(case: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    changes: dict[str, Any] = PEG if case == "peg" else TOOL
    if case == "seven joints":
        file = tmp_path / "seven.urdf"
        file.write_text(seven_joints(), "utf-8")
        changes = by_joints(file) | {"scene": "joints"}
    for name in catalogue.ends():
        real_time.make_ready(name)
    runs = [Simulation(Params().set(LINK | changes), 5)]
    monkeypatch.setattr("hapnet.simulation.simulation.no_compiler", lambda: "switched off")
    runs.append(Simulation(Params().set(LINK | changes), 5))
    fast, plain = (run.run() for run in runs)
    assert runs[0].not_compiled is not None, "the whole run is compiled: this says nothing of its ends"
    assert [isinstance(run.device.servo, CompiledServo) for run in runs] == [True, False]
    assert [isinstance(run.device.device.compiled, CompiledTicks) for run in runs] == [True, False]
    for side in ("device", "world"):
        ours, theirs = getattr(fast.recording, side), getattr(plain.recording, side)
        assert ours is not None
        assert ours.keys() == theirs.keys()
        for name in ours:
            np.testing.assert_array_equal(ours[name], theirs[name], err_msg=f"{side}.{name}")
    assert fast.summary["motion"]["peak_force_N"] > 0.0
