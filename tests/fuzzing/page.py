"""Mutated messages of a page to the live page's server: nothing is imported, changed or said, and no traceback.

``python -m tests.fuzzing.page --count 100000``. Each message is one of a page's own, made wrong in one way: so none may
have an effect. At the end a right one has its effect.
"""

import argparse
import asyncio
import math
import random
import sys
import time
from typing import Any

import msgspec
import viser
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

from hapnet.ext.page.history import History
from hapnet.ext.page.server import PageServer, serve
from hapnet.params import Params
from tests.view.feed import FakeControls, Feed

Message = dict[str, Any]
Control = tuple[str, Message, Any]
KINDS = {
    "GuiButtonMessage": (False, 1, 1.0, "true", None, [], {}),
    "GuiCheckboxMessage": (1, 0.0, "true", None, [True], {}),
    "GuiDropdownMessage": ("evilmod:x", "os:system", "", 1, True, None, ["free"], {"a": 1}, "x" * 5000, "\0"),
    "GuiSliderMessage": (math.nan, math.inf, -math.inf, 1e300, -1e300, "5", True, None, [1.0], 2**63),
    "GuiTextMessage": (1, True, None, ["ideal"], "x" * 1001, b"ideal"),
}
FOREIGN = (
    "ShareUrlRequest", "ShareUrlDisconnect", "GetRenderResponseMessage", "CommandTriggerMessage", "SetPositionMessage",
    "GuiButtonHoldMessage", "LocalStorageGetItemResponseMessage", "RunJavascriptMessage", "GuiRemoveMessage", "Message",
    "SceneNodeClickMessage", "ScenePointerMessage", "FileTransferPartAck", "ResetGuiMessage", "BackgroundImageMessage",
)  # fmt: skip
PROPERTIES = (
    "removed", "update_cb", "sync_cb", "is_button", "props", "gui_api", "uuid", "options", "min", "max", "visible",
    "disabled", "label", "__class__", "__dict__", "_impl", "value ", "order", "parent_container_id", "update_timestamp",
)  # fmt: skip


class PageMutator:
    """An endless stream of a page's messages, each wrong in one way. controls : what the page was sent."""

    def __init__(self, rng: random.Random, controls: dict[str, Control]) -> None:
        self._rng, self._controls = rng, controls

    def next(self) -> bytes | str:
        return self._rng.choice((self._value, self._value, self._value, self._property, self._field, self._bytes,
                                 self._foreign, self._camera, self._drag, self._upload))()  # fmt: skip

    def _update(self, uuid: str, value: object) -> Message:
        return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}

    def _value(self) -> bytes:
        uuid = self._rng.choice([uuid for uuid, (kind, _, _) in self._controls.items() if kind in KINDS])
        return _packed(self._update(uuid, self._rng.choice(KINDS[self._controls[uuid][0]])))

    def _property(self) -> bytes:
        message = self._update(self._rng.choice(list(self._controls)), True)
        updates = {self._rng.choice(PROPERTIES): self._rng.choice((True, None, [], "x", 1.0, {}))}
        return _packed(message | {"updates": self._rng.choice((updates, updates | message["updates"], {}, [], None))})

    def _field(self) -> bytes:
        message = self._rng.choice((self._update("", 1.0), _CAMERA, _DRAG, _UPLOAD))
        if self._rng.random() < 0.5:
            return _packed(message | {self._rng.choice(("x", "self", "excluded_self_client", "__class__")): 1})
        gone = self._rng.choice([name for name in message if name != "instance_index"])
        return _packed({name: value for name, value in message.items() if name != gone})

    def _bytes(self) -> bytes | str:
        data = _packed(self._rng.choice((_CAMERA, _DRAG, _UPLOAD, self._update("a", "b"))))
        return self._rng.choice((
            data[: self._rng.randrange(len(data))], b"\x91" * 2000, b"\xc1", self._rng.randbytes(20) + b"\xc1",
            "text", data.decode("latin-1"), b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff" + data, data + b"\0",
        ))  # fmt: skip

    def _foreign(self) -> bytes:
        kind = self._rng.choice((*FOREIGN, 1, None, "", "x" * 200))
        return _packed({"type": kind, "uuid": self._rng.choice(list(self._controls)), "name": "/handle", "url": "x"})

    def _camera(self) -> bytes:
        name = self._rng.choice([name for name in _CAMERA if name != "type"])
        odd = (math.nan, math.inf, "1", None, [], [1.0], [math.nan] * 4, ["a"] * 3, {}, -(2**40), 2**70 * 1.0, True)
        return _packed(_CAMERA | {name: self._rng.choice(odd)})

    def _drag(self) -> bytes:
        odd: tuple[Message, ...] = (
            {"name": "/nothing"}, {"phase": "begin"}, {"button": "fourth"}, {"end_position": [math.nan] * 3},
            {"start_position": [1e300, 0.0, 0.0]}, {"end_position": "abc"}, {"instance_index": "x"}, {"owner": None},
        )  # fmt: skip
        return _packed(_DRAG | self._rng.choice(odd))

    def _upload(self) -> bytes:
        button = next(uuid for uuid, (kind, _, _) in self._controls.items() if kind == "GuiUploadButtonMessage")
        other = next(uuid for uuid, (kind, _, _) in self._controls.items() if kind == "GuiDropdownMessage")
        part = {"type": "FileTransferPart", "source_component_uuid": button, "transfer_uuid": "t", "part_index": 0}
        upload = _UPLOAD | {"source_component_uuid": button}
        odd: tuple[Message, ...] = (
            upload | {"source_component_uuid": other}, upload | {"part_count": -1}, upload | {"size_bytes": 2**40},
            upload | {"part_count": 2.5}, upload | {"filename": "x" * 300}, upload | {"filename": None},
            part | {"content": b"abc"}, part | {"content": "abc"}, part | {"content": b"", "part_index": 2**62},
            upload | {"part_count": 0}, upload | {"size_bytes": 0},
        )  # fmt: skip
        return _packed(self._rng.choice(odd))


_CAMERA: Message = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0], "fov": 1.0, "near": 0.01,
    "far": 100.0, "image_height": 400, "image_width": 600, "look_at": [0.0] * 3, "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip
_DRAG: Message = {
    "type": "SceneNodeDragMessage", "phase": "update", "name": "/handle/grab", "instance_index": None, "button": "left",
    "start_position": [0.0] * 3, "start_screen_pos": [0.0, 0.0], "end_position": [1.0, 0.0, 0.0],
    "end_screen_pos": [0.5, 0.5], "modifier": None, "owner": "",
}  # fmt: skip
_UPLOAD: Message = {
    "type": "FileTransferStartUpload", "source_component_uuid": "", "transfer_uuid": "t", "filename": "a.stl",
    "mime_type": "", "part_count": 1, "size_bytes": 3,
}  # fmt: skip


def _packed(message: Message) -> bytes:
    return msgspec.msgpack.encode(message)


def opened(page: PageServer) -> connect:
    """A connection as the page itself makes it."""
    url, origin = page.url.rstrip("/"), page.url.rpartition(":")[0] + f":{page.port}"
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    return connect(url.replace("http", "ws"), origin=origin, subprotocols=[protocol], max_size=None)  # type: ignore[arg-type]


async def controls_of(browser: ClientConnection, seconds: float = 1.0) -> dict[str, Control]:
    """The controls that the page is sent: kind, properties and value, by their identifiers."""
    found: dict[str, Control] = {}
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0.0:
        try:
            frame = await asyncio.wait_for(browser.recv(decode=False), left_s)
        except TimeoutError:
            break
        size, packed = (int.from_bytes(frame[k : k + 8], "little") for k in (0, 8))
        data = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + packed], max_output_size=size)
        for message in msgspec.msgpack.decode(data)["messages"]:
            if message["type"].startswith("Gui") and isinstance(props := message.get("props"), dict):
                found[message["uuid"]] = message["type"], props, message.get("value")
            elif message["type"] == "GuiUpdateMessage" and message["uuid"] in found:
                kind, props, value = found[message["uuid"]]
                updates = message["updates"]
                found[message["uuid"]] = kind, {**props, **updates}, updates.get("value", value)
    return found


def choices(controls: dict[str, Control]) -> list[tuple[object, ...]]:
    """What a user can choose, and has chosen."""
    kinds = ("GuiDropdownMessage", "GuiSliderMessage", "GuiCheckboxMessage", "GuiTextMessage")
    return sorted(
        (uuid, value, str(props.get("options")), props.get("visible"), props.get("disabled"))
        for uuid, (kind, props, value) in controls.items() if kind in kinds
    )  # fmt: skip


async def storm(page: PageServer, calls: FakeControls, seed: int, count: int) -> None:
    """Send `count` wrong messages, then a right one."""
    async with opened(page) as browser:
        await browser.send(_packed(_CAMERA))
        controls = await controls_of(browser, 2.0)
        mutator, before, modules = PageMutator(random.Random(seed), controls), list(calls.calls), set(sys.modules)
        refused = page.refused
        reading = asyncio.create_task(_drained(browser))
        for _ in range(count):
            await browser.send(mutator.next())
        while page.refused < refused + count:
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.5)
        assert page.refused == refused + count
        assert calls.calls == before, calls.calls[len(before) :]
        assert not {name for name in set(sys.modules) - modules if not name.startswith(("encodings", "websockets"))}
        async with opened(page) as another:
            assert choices(await controls_of(another, 2.0)) == choices(controls)
        scene = next(u for u, (kind, props, _) in controls.items() if props.get("label") == "scene")
        await browser.send(_packed({"type": "GuiUpdateMessage", "uuid": scene, "updates": {"value": "box"}}))
        until_s = time.monotonic() + 20.0
        while ("scene", "box") not in calls.calls and time.monotonic() < until_s:
            await asyncio.sleep(0.05)
        assert ("scene", "box") in calls.calls
        reading.cancel()


async def _drained(browser: ClientConnection) -> None:
    async for _ in browser:
        pass


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(argv)
    history = History()
    with Feed(history, Params().set({"duration_s": 4.0, "operator": "rest"})) as feed:
        controls = FakeControls(feed)
        with serve(history, controls, port=0) as page:
            asyncio.run(storm(page, controls, given.seed, given.count))
            print(f"{given.count} messages refused, seed {given.seed}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
