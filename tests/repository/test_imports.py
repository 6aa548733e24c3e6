"""What only some commands need is loaded by these alone."""

import subprocess
import sys

import pytest

from tests.conftest import ENVIRONMENT


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("hapnet.recording.samples, hapnet.recording.mcap", {"mcap", "matplotlib", "rich", "zenoh"}),
        ("hapnet.ext.pictures.run, hapnet.ext.pictures.report", {"mcap", "matplotlib", "rich"}),
        ("hapnet, hapnet.cli, hapnet.ext.page.history, hapnet.ext.page.server", {"viser"}),
    ],
)
def test_modules_do_not_load_what_only_their_use_needs(modules: str, heavy: set[str]) -> None:
    code = f"import sys, {modules}; print(*{heavy} & set(sys.modules))"
    ran = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == ""
