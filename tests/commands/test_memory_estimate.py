"""Runs that no memory can hold are refused before they begin, with the numbers."""

import gc
import math
import tracemalloc

import pytest

from hapnet import cli, simulate, simulate_batch
from hapnet.assembly import memory
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from tests.conftest import mostly_slow


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["--seeds", "0:1000000000"], "hapnet: --seeds is range(0, 1000000000); allowed: at most "),
        (["--duration", "1e9", "--no-files"], "hapnet: --duration is 1000000000.0; allowed: at most "),
        (["--duration", "1e12", "--no-files"], "hapnet: --duration is 1000000000000.0; allowed: 0 to 1e+09"),
        (["--duration", "1e12", "--seeds", "0:2"], "hapnet: --duration is 1000000000000.0; allowed: 0 to 1e+09"),
    ],
)
def test_what_no_memory_holds_is_one_line_and_exit_code_2(
    argv: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["simulate", *argv]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(says)
    assert err.count("\n") == 1


def test_the_line_has_the_most_that_fits_and_what_all_would_need(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 GB holds 9,090 runs of 110 kB."""
    monkeypatch.setattr(memory, "installed_bytes", lambda: 1e9)
    with pytest.raises(InvalidParameter) as caught:
        simulate_batch([Params(), Params()], range(10_000))
    most = "at most 9,090 runs at 110 kB each: 20,000 need 2.2 GB of memory, and this machine has 1 GB"
    assert str(caught.value) == f"seeds is range(0, 10000); allowed: {most}"
    monkeypatch.setattr(memory, "installed_bytes", lambda: math.inf)
    memory.require_room("seeds", 1, 1e30, 1e30, "runs")


def _held_bytes() -> int:
    """What is still referred to: garbage of earlier runs and tests is collected at any time, or not yet."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.parametrize("dof", mostly_slow([3, 1], 0, 1))
def test_a_recorded_second_is_estimated_as_python_counts_it(dof: int) -> None:
    short = Params().set({"dof": dof, "scene": "moving", "duration_s": 0.5})  # not compiled, which takes less
    simulate(short)  # what is made once is made
    tracemalloc.start()
    try:
        sizes, kept = [], []
        for duration_s in (0.5, 1.5):
            before = _held_bytes()
            kept.append(simulate(short.set({"duration_s": duration_s})))
            sizes.append(_held_bytes() - before)
    finally:
        tracemalloc.stop()
    assert memory.bytes_a_second(short, dof) == pytest.approx(sizes[1] - sizes[0], rel=0.15)
