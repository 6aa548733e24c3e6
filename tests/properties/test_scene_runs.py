"""Every kind of rigid scene through the whole chain: PSPM over bad links, theorem, (13), the environment's account."""

from pathlib import Path

import pytest

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


@pytest.mark.parametrize(("name", "friction", "link", "step"), [
    ("mesh", 0.5, "bursts", "10 to 50 ms"), ("texture", 0.5, "jitter and loss", "10 to 50 ms"),
    ("walls", 0.0, "reordering", "10 to 50 ms"),
])  # fmt: skip
def test_a_scene_over_a_bad_link(name: str, friction: float, link: str, step: str, files: Path) -> None:
    check(run(words(name, files, friction), BAD_LINKS[link], STEPS_S[step]), name, friction, step)


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS_S)
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_over_every_bad_link(name: str, step: str, files: Path) -> None:
    """With and without friction, link by link in turn; steps of 1 ms take long, so they have two links only."""
    links = list(BAD_LINKS)[1:3] if step == "1 ms" else list(BAD_LINKS)
    for k, link in enumerate(links):
        friction = 0.5 if (k % 2 == 0 or name == "texture") and name != "walls" else 0.0
        check(run(words(name, files, friction), BAD_LINKS[link], STEPS_S[step]), name, friction, step)
