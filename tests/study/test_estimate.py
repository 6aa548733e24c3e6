"""How long a study takes: from a few of its parts, whichever they are."""

import re
from collections import Counter
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.commands import output
from hapnet.ext.study import task
from hapnet.ext.study.commands import studies
from hapnet.ext.study.task import mean_seconds, spread


class Clock:
    """Stands still but while a part runs, which takes as many seconds as its number says."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.ran: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def run(self, seconds: float) -> None:
        self.ran.append(seconds)
        self.now_s += seconds


def test_parts_of_the_whole_list_are_run_the_first_of_them_once_before() -> None:
    clock = Clock()
    parts = [float(k) / 100.0 for k in range(100)]
    mean_s, count = mean_seconds(clock.run, parts, clock=clock)
    first, *some = clock.ran
    assert (count, len(set(some)), first) == (8, 8, some[0])
    assert mean_s == pytest.approx(sum(some) / 8)
    assert {int(8 * seconds) for seconds in some} == set(range(8))  # one of each eighth of the list


@pytest.mark.parametrize("values", range(2, 9))
@pytest.mark.parametrize("others", [1, 2, 12, 25])
def test_the_parts_have_many_values_of_the_axis_that_varies_fastest(values: int, others: int) -> None:
    some = spread(list(range(values * others)))
    assert len(set(some)) == min(8, values * others)
    counts = Counter(part % values for part in some)
    assert len(counts) >= min(values, 4)
    assert max(counts.values()) <= 8 / values + 2


@pytest.mark.parametrize(("count", "ran"), [(1, 2), (2, 2), (3, 2), (4, 3), (5, 3), (16, 9)])
def test_of_a_short_list_half_is_run_so_that_an_estimate_takes_less_than_the_work(count: int, ran: int) -> None:
    clock = Clock()
    assert mean_seconds(clock.run, [0.5] * count, clock=clock) == (0.5, ran - 1)
    assert len(clock.ran) == ran


def test_no_part_is_begun_after_the_limit() -> None:
    clock = Clock()
    assert mean_seconds(clock.run, [2.0] * 8, 5.0, clock=clock) == (2.0, 2)
    assert mean_seconds(clock.run, [30.0] * 8, 5.0, clock=clock) == (30.0, 1)
    assert clock.ran == [2.0] * 3 + [30.0]


def test_kinds_are_added_up_and_shared_by_the_workers(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = Clock()
    monkeypatch.setattr(studies, "mean_seconds", lambda run, parts: task.mean_seconds(run, parts, clock=clock))
    kinds = [studies.PartKind("run", [0.2, 0.4] * 4, 400), studies.PartKind("search", [10.0], 3)]
    studies.estimate(output.console(None), clock.run, kinds, 3)
    studies.estimate(output.console(None), clock.run, kinds, 0, "tcp://scheduler:8786")
    kind = r"a run takes 0.3 s \(mean of 4\); a search takes 10 s \(mean of 1\); all of them, "
    with_workers, on_cluster = capsys.readouterr().out.splitlines()
    assert re.fullmatch(kind + "with 3 workers: about 50 s", with_workers)
    assert re.fullmatch(kind + "2 min in total, shared by the cluster's workers", on_cluster)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (
            ["compare", "--coupling", "pspm,zoh", "--link", "lan", "--operator", "press", "--seeds", "0:2"],
            [
                "6 cases: 2 couplings, 1 link, 1 operator, 2 seeds, and 2 of the local wall",
                "  coupling: pspm; zoh",
                "  link: lan",
            ],
        ),
        (["transparency", "--coupling", "pspm", "--seeds", "0:2"], ["4 runs: 2 pairs of a coupling and a link"]),
        (
            ["transparency", "--coupling", "pspm", "--link", "4g", "--z-width"],
            [
                "3 runs, 2 searches for the stiffest wall: 1 pair of a coupling and a link",
                "36 searches for the stiffest stable spring of the device",
            ],
        ),
    ],
)
def test_a_dry_run_says_what_would_run_and_how_long_and_writes_nothing(
    argv: list[str],
    said: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(studies, "mean_seconds", lambda run, parts: (1.5, len(parts)))
    assert cli.main([*argv, "--dry-run", "--workers", "1"]) == 0
    *reported, estimated = capsys.readouterr().out.splitlines()
    assert reported[: len(said)] == said
    assert re.fullmatch(
        r"a (case takes 3|run takes 1.5) s \(mean of \d\); .*all of them, with 1 worker: about \d+ s", estimated
    )
    assert list(tmp_path.iterdir()) == []
