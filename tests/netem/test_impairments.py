"""An impairment beside tc-netem's words: the page's example, put into the folder and used as it stands."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import netem

USE = """
import json
from netem import Link, LinkProfile, expect
from netem.errors import ProfileError

def through(words, step_ns, count, seed=3):
    link = Link(LinkProfile.parse(words), seed=seed)
    for n in range(count):
        link.send(n * step_ns, n, 10)
    return [(due - n * step_ns, n) for due, n in link.poll(10**15)], link.stats

MS = 10**6
words = "delay 5ms loss 10% handover 100ms 20ms 25%"
profile = LinkProfile.parse(words)
refused = []
for wrong in ("handover 20ms 100ms", "handover 20ms", "handover 9ms 1ms handover 9ms 1ms", "handovers 9ms 1ms"):
    try:
        LinkProfile.parse(wrong)
    except ProfileError as error:
        refused.append(str(error))
arrived, stats = through(words, 1_234_567, 50_000)
plain, _ = through("delay 5ms loss 10%", 1_234_567, 50_000)
whole, _ = through("delay 5ms handover 100ms 20ms", MS, 250)
print(json.dumps({
    "again": str(LinkProfile.parse(str(profile))) == str(profile) and LinkProfile.parse(str(profile)) == profile,
    "text": str(profile), "refused": refused, "expected": expect(profile).as_dict(),
    "loss": stats.lost / stats.offered, "delays": [d for d, _ in arrived], "whole": sorted((n, d) for d, n in whole),
    "same_losses": {n for _, n in arrived} <= {n for _, n in plain},
}))
"""


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    root = tmp_path_factory.mktemp("impaired")
    shutil.copytree(Path(netem.__file__).parent, root / "netem", ignore=shutil.ignore_patterns("__pycache__"))
    page = (root / "netem/README.md").read_text("utf-8").partition("## Add an impairment")[2]
    (root / "netem/impairments/handover.py").write_text(page.partition("```python\n")[2].partition("```")[0], "utf-8")
    command = [sys.executable, "-c", USE]
    said = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=120, check=True).stdout
    return json.loads(said)


def test_its_words_are_read_and_written(used: dict[str, Any]) -> None:
    assert used["text"] == "delay 5ms loss 10% handover 100ms 20ms 25%"
    assert used["again"]
    for said, why in zip(
        used["refused"],
        ("a length between", "a value after handover", "it is given twice", "did you mean handover"),
        strict=True,
    ):
        assert why in said


def test_what_is_sent_while_the_link_is_away_waits_until_it_is_back(used: dict[str, Any]) -> None:
    assert used["whole"] == [[n, 5_000_000 + max(0, 20 - n % 100) * 1_000_000] for n in range(250)]


def test_losses_and_delays_are_as_its_author_says_and_the_loss_models_draws_stay(used: dict[str, Any]) -> None:
    """10 % of all, and of the rest a quarter of the fifth that is sent while the link is away."""
    expected, delays = used["expected"], used["delays"]
    assert expected["loss"] == pytest.approx(0.1 + 0.9 * 0.05)
    assert used["loss"] == pytest.approx(expected["loss"], abs=4 * (0.145 * 0.855 / 50_000) ** 0.5)
    mean = sum(delays) / len(delays)
    assert mean * 1e-6 == pytest.approx(expected["delay_mean_ms"], rel=0.02)
    # of those that arrive 15/95 wait, 10 ms in the mean
    assert expected["delay_mean_ms"] == pytest.approx(5.0 + 10.0 * 15 / 95)
    assert used["same_losses"]
