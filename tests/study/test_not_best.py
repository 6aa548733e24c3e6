"""Where PSPM is not the best: from tables whose order is known, and on the page of the comparison."""

from hapnet.ext.study import not_best
from tests.conftest import ROOT

FELT = {
    "pspm": {"lan": "20/20 · 100 · 0.7 · 0.2 · 0.01", "4g": "20/20 · 99 · 0.7 · 0.7 · 0.01"},
    "zoh": {"lan": "20/20 · 101 · 0.7 · 0.1 · -0.02", "4g": "10/20 · 99 · 0.6 · 0.5 · 0.01"},
    "pd": {"lan": "20/20 · 52 · 4.5 · 1.4 · –", "4g": "20/20 · 52 · 23.3 · 0.6 · 0.00"},
    "local wall": {"lan": "20/20 · 100 · 0.1 · 0.0 · 0.00", "4g": "20/20 · 100 · 0.1 · 0.0 · 0.00"},
}
ENERGY = {
    "pspm": {"lan": "0.9 · 0.0 · 11.8", "4g": "2.5 · 0.0 · 10.8"},
    "zoh": {"lan": "0.9 · 0.0 · 12.5", "4g": "2702 · 228 · 2613"},
    "pd": {"lan": "0.0 · 0.0 · 2.4", "4g": "3.0 · 0.0 · 11.0"},
    "local wall": {"lan": "0.0 · 0.0 · 0.0", "4g": "0.0 · 0.0 · 0.0"},
}


def test_each_figure_in_which_another_law_is_better() -> None:
    """Equal figures do not count; 101 % is as far from 100 as 99; -0.02 N is farther from 0 than 0.01 N; of a law that
    was not passive the count stands beside it, and the best passive law follows."""
    assert not_best.lines("pspm", FELT, ENERGY, ["local wall"]) == [
        "force error [%]: 4g 0.6 with `zoh` (passive in 10 of 20 cases), 0.7 with `pspm`",
        "free motion [mm]: lan 0.1 with `zoh`, 0.2 with `pspm`; "
        "4g 0.5 with `zoh` (passive in 10 of 20 cases), 0.6 with `pd`, 0.7 with `pspm`",
        "drag [N]: 4g 0 with `pd`, 0.01 with `pspm`",
        "energy out of both ports [mJ]: lan 0 with `pd`, 0.9 with `pspm`",
        "energy out at the world's port [mJ]: lan 2.4 with `pd`, 11.8 with `pspm`",
    ]


def test_a_law_that_is_the_best_everywhere() -> None:
    alone = {"pspm": FELT["pspm"], "pd": {"lan": "20/20 · 52 · 4.5 · 1.4 · 0.1", "4g": "1/20 · 52 · 23.3 · 0.9 · 0.1"}}
    energy = {"pspm": ENERGY["zoh"], "pd": ENERGY["zoh"]}
    assert not_best.section("pspm", alone, energy)[0] == "**`pspm` is the best in every figure of these tables.**"


def test_the_comparisons_page_says_what_its_tables_show() -> None:
    """Each section that ends in such a list has the lines that its own two tables give, and no others."""
    text = (ROOT / "hapnet" / "ext" / "study" / "comparison.md").read_text("utf-8").splitlines()
    heads = [number for number, line in enumerate(text) if line == "**Where `pspm` is not the best:**"]
    assert heads
    for head in heads:
        start = max(number for number in range(head) if text[number].startswith("## "))
        part = text[start:head]
        felt, energy = not_best.read(part, "Cases in which"), not_best.read(part, "The most energy")
        end = next(number for number in range(head + 2, len(text)) if not text[number].startswith("* "))
        wanted = [f"* {line}" for line in not_best.lines("pspm", felt, energy, ["local wall"])]
        assert text[head + 2 : end] == wanted
