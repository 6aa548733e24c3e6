"""Every figure with a unit that README gives is that of a run today, of a default, or of the comparison; no other."""

import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from examples.pictures import compare
from hapnet.ext.study.case import measure
from hapnet.ext.study.plans import BASE, plans
from hapnet.simulation.simulation import simulate
from tests.conftest import ROOT, mostly_slow
from tests.support.pages import blocks, run_shell

README = ROOT / "README.md"
COMPARISON = ROOT / "hapnet" / "ext" / "study" / "comparison.md"
FACTORS = {  # a unit on the page: the ends of names in a summary or of parameters, and the factor from one to the other
    "mJ": {"_J": 1e3, "_mJ": 1.0}, "J": {"_J": 1.0}, "N/m": {"_N_m": 1.0, "stiffness": 1.0}, "N": {"_N": 1.0},
    "mm": {"_m": 1e3, "_mm": 1.0}, "ms": {"_s": 1e3, "_ms": 1.0}, "s": {"_s": 1.0}, "Hz": {"_hz": 1.0},
    "kHz": {"_hz": 1e-3}, "%": {"_loss": 100.0, "_percent": 1.0, "loss": 100.0},
}  # fmt: skip
FIGURE = re.compile(r"(?<![\w.,/-])(-?\d[\d,]*(?:\.\d+)?)\s?(mJ|J|N/m|N|mm|ms|s|kHz|Hz|%)(?![\w/²])")
ELSEWHERE = {"100 N/m": "device.stiffness of the comparison's first cases"}
"""Figures that are no value of a run by themselves, and where they come from."""


def prose(text: str) -> str:
    """A page without its code, comments, and the addresses of its links."""
    text = re.sub(r"(?ms)^```.*?^```$|<!--.*?-->", "", text)
    return re.sub(r"`[^`]*`|\]\([^)]*\)", " ", text)


def fits(shown: str, value: float) -> bool:
    """Whether the number is the value, rounded to as many digits."""
    digits = len(shown.partition(".")[2])
    number = float(shown.replace(",", ""))
    whole = shown.replace(",", "").lstrip("-")
    step = 10.0**-digits if digits else 10.0 ** (len(whole) - len(whole.rstrip("0")) if len(whole) > 3 else 0)
    return abs(number - value) <= 0.5 * step * (1.0 + 1e-9) + 1e-12


def leaves(table: Mapping[str, Any] | list[Any], name: str = "") -> Iterator[tuple[str, float]]:
    """Names and numbers of a nested table."""
    parts = table.items() if isinstance(table, Mapping) else [(name, value) for value in table]
    for key, value in parts:
        if isinstance(value, Mapping | list | tuple):
            yield from leaves(list(value) if isinstance(value, tuple) else value, key)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield key, float(value)


@cache
def measured() -> tuple[tuple[str, float], ...]:
    """Of the run whose output README prints, and of the defaults."""
    result = simulate(seed=1)
    return (*leaves(result.summary), *leaves(result.recording.meta["params"]))


@cache
def compared() -> tuple[tuple[str, float], ...]:
    """The most energy of each coupling in the comparison's table of cases, in mJ."""
    return tuple(
        ("out_mJ", max(float(row[name]) for row in rows))
        for _, rows in of_couplings()
        for name in ("out_mJ", "hand_out_mJ", "world_out_mJ")
    )


def of_couplings() -> Iterable[tuple[tuple[str, str], list[dict[str, str]]]]:
    with compare.FILE.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for world in compare.WORLDS:
        for coupling in compare.NAMES:
            yield (world, coupling), [row for row in rows if (row["world"], row["coupling"]) == (world, coupling)]


def given(text: str) -> str:
    """What the page's own commands and programs ask for."""
    return " ".join(re.findall(r"(?ms)^```(?:sh|python)$.*?^```$|`[^`]*`", text))


def unknown(text: str) -> list[str]:
    """The figures of a page that nothing makes. In a table of couplings: that no row of the comparison has."""
    wrong, asked = [], given(text)
    for line in text_of_lines(text):
        row = tables(tuple(re.findall(r"[\w-]+", line.lower()))) if line.startswith("|") else ""
        for number, unit in FIGURE.findall(prose(line)):
            known = any(
                name.endswith(end) and fits(number, factor * value)
                for end, factor in FACTORS[unit].items()
                for name, value in (*measured(), *compared())
            )
            words = f"{number} {unit}"
            in_row = any(fits(number, float(value)) for value in re.findall(r"\d[\d.]*", row))
            if not (in_row if row else known or words in ELSEWHERE or number + unit in asked):
                wrong.append(words)
    return wrong


def text_of_lines(text: str) -> list[str]:
    """A page's lines outside its code."""
    return re.sub(r"(?ms)^```.*?^```$", "", text).splitlines()


@cache
def tables(couplings: tuple[str, ...]) -> str:
    """The rows of the comparison's page for these couplings."""
    rows = re.findall(r"(?m)^\| `([\w-]+)(?::[^`]*)?`(.*)$", COMPARISON.read_text("utf-8"))
    return "\n".join(row for name, row in rows if name in couplings)


def test_every_figure_of_readme_is_made_by_something() -> None:
    assert FIGURE.findall(prose(README.read_text("utf-8")))
    assert unknown(README.read_text("utf-8")) == []


@pytest.mark.parametrize(("figure", "by_hand"), [("600 N/m", "700 N/m"), ("150 mJ", "160 mJ"), ("150 mJ", "15 mJ")])
def test_a_figure_of_readme_that_is_changed_by_hand_is_found(figure: str, by_hand: str) -> None:
    text = README.read_text("utf-8") + f"\nA wall is felt as {figure}.\n"
    assert unknown(text) == []
    assert unknown(text.replace(figure, by_hand)) != []


def test_the_output_in_readme_is_what_its_command_prints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a digit that is changed by hand is found."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (shown,) = [block for block in blocks(README) if block.printed is not None]
    printed = run_shell(shown)
    assert printed == shown.printed
    for number in set(re.findall(r"\d+", printed)):
        copy = tmp_path / f"{number}.md"
        text = README.read_text("utf-8")
        place = text.index(printed) + printed.index(number)
        other = str((int(number[0]) + 1) % 10)
        copy.write_text(text[:place] + other + text[place + 1 :], "utf-8")
        (changed,) = [block for block in blocks(copy) if block.printed is not None]
        assert changed.printed != printed


def test_the_comparisons_page_has_the_figures_of_its_cases() -> None:
    """What came out at most, and the medians over hands, with false planes and at a wall that moves."""
    page = COMPARISON.read_text("utf-8")
    for (world, coupling), rows in of_couplings():
        section = page.split(
            "\n## A world that sends false planes" if world == "lying" else "\n## A wall that moves and softens"
        )[1]
        (found,) = re.findall(rf"(?m)^\| `{coupling}` \|(.*) \|$", section.partition("\n## ")[0])
        *_, about, out = found.split(" | ")
        most = [max(float(row[name]) for row in rows) for name in ("out_mJ", "hand_out_mJ", "world_out_mJ")]
        assert all(map(fits, out.split(" · "), most)), (world, coupling, out, most)
        names = ("stiffness_percent", "force_error_percent", "free_mm", "drag_N")[world == "moving" :]
        passive, *medians = about.split(" · ")
        kept = sum(float(row["out_mJ"]) <= compare.BOUND_MJ for row in rows)
        assert passive.strip() == f"{kept}/{len(rows)}"
        for shown, name in zip(medians, names, strict=True):
            value = median(float(row[name]) for row in rows if row[name])
            assert float(shown) == pytest.approx(value, abs=0.51 * 10.0 ** -len(shown.partition(".")[2])), name


@pytest.mark.parametrize(
    ("world", "coupling"),
    mostly_slow([("lying", "pspm"), ("lying", "zoh"), ("moving", "pspm")], 0, 2),
)
def test_a_case_of_the_comparison_is_measured_as_before(world: str, coupling: str) -> None:
    bench, changes = {
        "lying": ("hands", {"scene": "examples.pictures.lying:liar"}),
        "moving": ("moves", {}),
    }[world]
    (row, *_) = dict(of_couplings())[world, coupling]
    (plan,) = plans(
        BASE.set(changes), bench=bench, couplings=[coupling], links=["4g"], operators=[row["operator"]], deadbands=[0.0]
    ).values()
    found = measure(plan.cases()[0].params, int(row["seed"]))
    for name, (metric, factor) in compare.MEASURES.items():
        value = found[metric]
        assert (value is None) == (row[name] == "")
        assert value is None or factor * value == pytest.approx(float(row[name]), rel=1e-3), name
