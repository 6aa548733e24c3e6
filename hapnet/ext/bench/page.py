"""The cost of the live page of a scene with 10,000 triangles: updates that reach a client, and the servo's lateness."""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.ext.bench.mesh import torus
from hapnet.ext.bench.row import Limit, Options, Row
from hapnet.ext.bench.servo import late_row
from hapnet.ext.bench.sides import beside_and_alone
from hapnet.params import Params
from hapnet.processes.child import Child, WaitForStart
from hapnet.transport.config import ZenohSettings, free_address

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

_STEP_S = 0.005
_SETTLED_S = 1.0
"""The time after the first update before the measurement [s], as the whole page is sent at first."""

_WHAT = "lateness while a client is sent the page of 10,000 triangles, 60 times a second"
_AGAINST = "the same pair without a page, in turns"


@dataclass(frozen=True)
class Received:
    """The data at a client: times of updates after the first second [s], bytes a second, how often it got the torus."""

    times_s: tuple[float, ...]
    bytes_hz: float
    surfaces: int

    @property
    def updates_hz(self) -> float:
        return (len(self.times_s) - 1) / (self.times_s[-1] - self.times_s[0]) if len(self.times_s) > 2 else 0.0


def page_mesh(options: Options) -> Row:
    """A pair in front of a torus, with a page and a client, which reads the data that a browser would receive."""
    missing = [name for name in ("viser", "igl") if find_spec(name) is None]
    if missing:
        return Row("page_mesh", "us", _WHAT, against=_AGAINST, note=f"{' and '.join(missing)} not installed")
    received: list[Received] = []
    busy: list[float] = []
    with TemporaryDirectory(prefix="hapnet-bench-") as directory:
        params = Params().set(
            {
                "scene": f"mesh:{_written(Path(directory))}?unit=m&at=file&friction=0.5",
                "link.up": "", "link.down": "", "operator": "press", "duration_s": options.seconds + _SETTLED_S,
                "world.step_min_s": _STEP_S, "world.step_max_s": _STEP_S,
            }
        )  # fmt: skip
        watched, alone = beside_and_alone(params, options, partial(_shown, options.seconds, received, busy))
    gaps_ms = 1e3 * np.concatenate([np.diff(one.times_s) for one in received])
    more = {
        "updates_hz": min(one.updates_hz for one in received),
        "update_gap_p99_ms": float(np.quantile(gaps_ms, 0.99)) if len(gaps_ms) else float("inf"),
        "surfaces_sent": float(max(one.surfaces for one in received)),
        "kB_a_second": max(one.bytes_hz for one in received) / 1e3,
        "page_cpu": max(busy),
    }
    limits = Limit("updates_hz", 57.0, at_least=True), Limit("surfaces_sent", 1.0), Limit("ratio_p99", 1.2)
    return late_row("page_mesh", _WHAT, watched, _AGAINST, alone, more, limits)


def _written(directory: Path) -> Path:
    """The torus as a file [m]."""
    vertices, triangles = torus()
    lines = [*(f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in vertices.tolist())]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    file = directory / "torus.obj"
    file.write_text("\n".join(lines) + "\n", encoding="ascii")
    return file


@contextlib.contextmanager
def _shown(seconds: float, received: list[Received], busy: list[float], address: str) -> Iterator[None]:
    """A page and a client, processes of their own, while the pair whose world listens at `address` runs."""
    from hapnet.ext.page.gate import new_token

    port, token = int(free_address().rpartition(":")[2]), new_token()
    with Child(_serve, address, seconds, port, token) as server, Child(_receive, port, token, seconds) as client:
        for child in (server, client):
            child.wait_ready()
        for child in (server, client):
            child.go()
        yield
        received.append(client.result(30.0))
        busy.append(server.result(30.0))


def _serve(wait_for_start: WaitForStart, address: str, seconds: float, port: int, token: str) -> float:
    """Serve the page; returns its CPU time per second, from the first update to the last."""
    from hapnet.ext.page.history import History
    from hapnet.ext.page.server import serve
    from hapnet.ext.page.watcher import Watcher

    history = History()
    watcher = Watcher(ZenohSettings(connect=(address,)), history.take)
    watcher.open()
    with serve(history, port=port, token=token) as page:
        _wait(lambda: page.watched and watcher.pair is not None)
        wait_for_start()
        _wait(lambda: history.snapshot().taken > 0)
        time.sleep(_SETTLED_S)
        began, used = time.monotonic(), time.process_time()
        time.sleep(0.8 * seconds)
        share = (time.process_time() - used) / (time.monotonic() - began)
        _wait(lambda: not page.watched)  # the client has read everything
    watcher.close()
    return share


def _wait(until: Callable[[], bool]) -> None:
    while not until():
        time.sleep(0.05)


def _receive(wait_for_start: WaitForStart, port: int, token: str, seconds: float) -> Received:
    """Act as a browser towards the server: send a camera, and read all messages.

    It stands for a browser on another machine, so it runs with the lowest priority here.
    """
    if sys.platform != "win32":
        os.nice(19)
    times, total, surfaces, first = list[float](), 0, 0, float("inf")
    with _connected(port, token) as client, contextlib.suppress(TimeoutError):
        client.send(_camera())
        wait_for_start()
        while time.monotonic() < first + _SETTLED_S + 0.8 * seconds:
            data = client.recv(timeout=2.0 * seconds + 30.0)
            now = time.monotonic()
            messages = _messages(data) if isinstance(data, bytes) else []
            surfaces += sum(m["type"] == "MeshMessage" and m["name"] == _TORUS for m in messages)
            if not any(m["type"] == "SetPositionMessage" and m["name"] in _MOVING for m in messages):
                continue
            first = min(first, now)
            if now >= first + _SETTLED_S:
                times.append(now)
                total += len(data)
    span = times[-1] - times[0] if len(times) > 1 else 1.0
    return Received(tuple(times), total / span, surfaces)


def _connected(port: int, token: str) -> ClientConnection:
    """A connection to the page's server, once it listens."""
    from websockets.sync.client import connect
    from websockets.typing import Origin, Subprotocol

    spoken, page = Subprotocol(f"viser-v{_version()}"), f"127.0.0.1:{port}"
    while True:
        try:
            return connect(
                f"ws://{page}/{token}/", origin=Origin(f"http://{page}"), subprotocols=[spoken], max_size=None,
                compression=None,
            )  # fmt: skip
        except OSError:
            time.sleep(0.05)


_MOVING = ("/handle", "/proxy")
_TORUS = "/body_part_0"


def _version() -> str:
    """The version of viser, which a client must send."""
    import viser

    return str(viser.__version__)


def _camera() -> bytes:
    """The first message of a browser, its camera."""
    import msgpack

    message = {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -24.0, 0.0), "fov": 0.5,
        "near": 0.01, "far": 1000.0, "image_height": 720, "image_width": 1280, "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
    }  # fmt: skip
    return bytes(msgpack.packb(message))


def _messages(data: bytes) -> list[dict[str, Any]]:
    """The messages in a frame from the server: two lengths, zstd-compressed msgpack, then arrays."""
    import msgpack
    import zstandard

    size, packed = struct.unpack("<QQ", data[:16])
    text = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=size)
    return list(msgpack.unpackb(text, strict_map_key=False)["messages"])
