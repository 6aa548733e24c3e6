"""Broken files and a page's broken messages, in processes of their own: refused in order, and nothing is printed."""

import subprocess
import sys

import pytest

from tests.conftest import ENVIRONMENT, mostly_slow

MINUTES = 60


def run(program: str, *words: object, timeout_s: float = 200.0) -> str:
    command = [sys.executable, "-m", f"tests.fuzzing.{program}", *map(str, words)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=timeout_s, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stderr == ""  # no library's traceback either
    return done.stdout


@pytest.mark.long
@pytest.mark.parametrize("kind", mostly_slow(["toml", "urdf", "npy", "journal", "recording", "mesh", "mujoco"], 1))
def test_broken_files_are_refused_in_one_line(kind: str) -> None:
    pytest.importorskip("trimesh", reason="the extra mesh is not installed")
    if kind == "mujoco":
        pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    found = run("files", "--kind", kind, "--count", 250, "--seed", 2)
    assert "'refused'" in found
    assert "'read'" in found


@pytest.mark.slow
@pytest.mark.long
def test_broken_messages_of_a_page_do_nothing() -> None:
    pytest.importorskip("viser", reason="the live page's library is not installed")
    assert "1500 messages refused" in run("page", "--count", 1500)


@pytest.mark.soak
@pytest.mark.slow
def test_a_hundred_thousand_of_each() -> None:
    run("page", "--count", 100_000, timeout_s=60 * MINUTES)
    run("files", "--count", 100_000, timeout_s=60 * MINUTES)
