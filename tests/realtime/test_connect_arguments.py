"""What can be given to `connect_device` and `connect_world`, and what is said of what cannot."""

import asyncio
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from hapnet import InvalidParameter, Scene, Wall, ZenohSettings, connect_device, connect_world
from hapnet.errors import HapnetError, RecordingError, TransportError
from hapnet.loading import load
from hapnet.transport.config import free_address, local_address
from tests.support.cancelling import Handle
from tests.support.pairs import WAIT_S

NOBODY = "tcp/127.0.0.1:1"
SETTINGS: dict[str, object] = {"link.up": "ideal", "link.down": "ideal"}


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"params": "4g"}, "^params is '4g'; allowed: a Params, or changes such as"),
    ({"params": {"linkk.up": "4g"}}, "link.up"),
    ({"params": {"device.mass": -1.0}}, "^device.mass is -1.0"),
    ({"params": {"duration_s": 3.0}}, "duration_s as an argument of its own"),
    ({"connect": 5}, "^connect is 5; allowed: an endpoint such as tcp/"),
    ({"connect": [5]}, r"^connect is \[5\]"),
    ({"connect": "tcp/x"}, "^connect is 'tcp/x'; allowed: PROTOCOL/ADDRESS:PORT"),
    ({"listen": "here"}, "^listen is 'here'"),
    ({"zenoh": "peer"}, "^zenoh is 'peer'"),
    ({"zenoh": ZenohSettings(connect=(NOBODY,)), "listen": NOBODY}, "give listen inside zenoh, or leave zenoh out"),
    ({"device": 5}, "^device is 5; allowed: simulated, omni, "),
    ({"device": "nowhere:Arm"}, "^device nowhere:Arm: cannot import module 'nowhere'"),
    ({"device": object}, "^device <class 'object'>: the class object has no method read and no method apply"),
    ({"scene": 5}, "^scene is 5; allowed: a scene's name, a world, or a function that makes one"),
    ({"scene": "nowhere"}, "^scene is 'nowhere'"),
    ({"seed": -1}, "^seed is -1; allowed: a whole number, 0 or above"),
    ({"duration_s": -1.0}, "^duration_s is -1.0"),
    ({"duration_s": "3"}, "^duration_s is '3'"),
    ({"record": 5}, "^record is 5"),
    ({"session": "a b"}, "^session is 'a b'"),
    ({"name": None}, "^name is None"),
    ({"realtime": 1}, "^realtime is 1; allowed: True or False"),
    ({"once": None}, "^once is None"),
]


@pytest.mark.parametrize(("given", "says"), WRONG, ids=[" ".join(map(str, case[0].items()))[:40] for case in WRONG])
async def test_a_wrong_argument_is_named_with_what_is_allowed(given: dict[str, Any], says: str) -> None:
    address = {} if {"connect", "listen", "zenoh"} & set(given) else {"connect": NOBODY}
    with pytest.raises(InvalidParameter, match=says):
        async with connect_device(**given, **address):
            pass


async def test_what_is_not_possible_is_raised_as_the_block_begins(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(TransportError, match="cannot open Zenoh"):
            async with connect_world(listen=f"tcp/127.0.0.1:{taken.getsockname()[1]}"):
                pass
    Handle.made.clear()
    for given, error, says in (
        ({"record": "/proc/no.mcap"}, RecordingError, r"/proc/no\.mcap"),
        ({"session": "a/b"}, InvalidParameter, "session"),
    ):
        with pytest.raises(error, match=says):
            async with connect_device(device=Handle, listen=free_address(), **given):  # type: ignore[arg-type]
                pass
    assert not Handle.made  # nothing was opened that would have to be closed
    assert not list(tmp_path.iterdir())


def corridor(*, dof: int = 1) -> Scene:
    return Scene("corridor", dof, [Wall([1.0] + [0.0] * (dof - 1), 0.01, 3000.0, 10.0)])


class Empty:
    """A world of one's own that steps: of its summary more is asked than of others."""

    name = "corridor"
    dof = 1

    def step(self, dt: float, position: Sequence[float], velocity: Sequence[float]) -> float:
        return 0.0


@pytest.mark.slow
async def test_devices_and_scenes_may_be_objects_classes_or_functions(tmp_path: Path) -> None:
    names, address = [], local_address(str(tmp_path))
    Handle.made.clear()
    for scene, device in (
        (corridor, Handle),
        (corridor(), Handle()),
        (lambda: corridor(), lambda dof: Handle()),
        (lambda: Empty(), Handle()),
    ):
        async with (
            asyncio.timeout(WAIT_S),
            connect_world(SETTINGS, scene=scene, listen=address) as world,
            connect_device(SETTINGS, scene=scene, device=device, connect=address) as connected,  # type: ignore[arg-type]
        ):
            await connected.wait_paired()
            await anext(world.samples())
            params = connected._task.side.setup.params
            names.append((params.scene, params.hardware))
            assert connected._task.side.setup.scene.name == "corridor"
        assert {world.summary()["coupling"], connected.summary()["coupling"]} == {"pspm"}
    assert names[0] == (f"{__name__}:corridor", "tests.support.cancelling:Handle")
    assert [handle.closed for handle in Handle.made] == [True] * 4
    for pair in names[1:]:
        for name in pair:
            assert name.startswith("object:")
            with pytest.raises(InvalidParameter):
                load("scene", name, "a scene")  # it is forgotten


@pytest.mark.parametrize("connect", [connect_device, connect_world])
def test_without_asyncio_one_line_says_what_to_choose(connect: Any) -> None:
    """As on trio: the block is entered where no loop of asyncio runs."""
    entering = connect(SETTINGS, connect=NOBODY).__aenter__()
    with pytest.raises(HapnetError, match=f"^{connect.__name__} needs asyncio's event loop.* not trio$"):
        entering.send(None)
