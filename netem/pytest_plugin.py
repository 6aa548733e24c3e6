"""pytest's fixture `netem_relay`: an emulated link before any UDP or TCP program, for the length of a test.

def test_survives_loss(netem_relay):
    relay = netem_relay("127.0.0.1:5000", "delay 40ms loss 5%")
    client.connect(relay.address)

Its arguments are those of `netem.background.BackgroundRelay`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from netem.background import BackgroundRelay


@pytest.fixture
def netem_relay() -> Iterator[Callable[..., BackgroundRelay]]:
    """Starts a relay that runs until the test ends; may be called several times."""
    with ExitStack() as running:

        def start(*args: Any, **options: Any) -> BackgroundRelay:
            from netem.background import BackgroundRelay  # here: every run of pytest loads this module

            return running.enter_context(BackgroundRelay(*args, **options))

        yield start
