"""Every kind of rigid scene through the whole chain: PSPM over bad links, theorem, (13), the environment's account."""

from pathlib import Path

import pytest

from tests.conftest import mostly_slow
from tests.support.scene_runs import BAD_LINKS, SCENES, STEPS_S, Outcome, run, words, write_files


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("scenes"))


def check(found: Outcome, name: str, friction: float, step: str) -> None:
    assert found.balance_J <= 1e-14
    assert found.env_slack_J >= -1e-14
    assert found.slack_J >= -1e-9
    assert found.last_force_N <= 1e-12
    assert found.touched > (6 if step == "100 ms" else 15)  # of some 17, and a hand bounces over the slowest
    if name == "sphere":
        assert found.depth_m <= 1.75e-3
    if step == "1 ms" and friction and name in ("mesh", "relief"):
        assert found.jump_95_N <= 0.2


@pytest.mark.parametrize(("name", "friction", "link", "step"), mostly_slow([
    ("mesh", 0.5, "bursts", "10 to 50 ms"), ("texture", 0.5, "jitter and loss", "10 to 50 ms"),
    ("walls", 0.0, "reordering", "10 to 50 ms"),
], 1))  # fmt: skip
def test_a_scene_over_a_bad_link(name: str, friction: float, link: str, step: str, files: Path) -> None:
    check(run(words(name, files, friction), BAD_LINKS[link], STEPS_S[step]), name, friction, step)


EACH = [
    (name, step, k)
    for number, name in enumerate(SCENES)
    for step, k in (("100 ms", number % 4), ("10 to 50 ms", (number + 1) % 4))
] + [("mesh", "1 ms", 0), ("relief", "1 ms", 0)]
"""Each scene over two links, and what feels smooth with short steps: all others take hours."""

EVERY = [(name, step, k) for name in SCENES for step in STEPS_S for k in (range(4) if step != "1 ms" else range(2))]
"""Steps of 1 ms take long, so they have two links only."""


@pytest.mark.parametrize(
    ("name", "step", "k"),
    mostly_slow([*EACH, *(case for case in EVERY if case not in EACH)], 0, len(EACH)),
)
def test_every_scene_over_every_bad_link(name: str, step: str, k: int, files: Path) -> None:
    """With and without friction, link by link in turn."""
    link = (list(BAD_LINKS)[1:3] if step == "1 ms" else list(BAD_LINKS))[k]
    friction = 0.5 if (k % 2 == 0 or name == "texture") and name != "walls" else 0.0
    check(run(words(name, files, friction), BAD_LINKS[link], STEPS_S[step]), name, friction, step)
