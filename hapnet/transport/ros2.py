"""A ROS 2 node over Zenoh, without ROS: rmw_zenoh's keys and messages. CDR is by `rosbags` (extra `ros2`).

| what | as |
|---|---|
| a topic's key | ``<domain>/<topic>/<type>/<hash of the type>`` |
| a node's token | ``@ros2_lv/<domain>/<session>/<node>/<node>/NN/<enclave>/<namespace>/<name>`` |
| a publisher's (MP), a subscription's (MS) | ``@ros2_lv/<domain>/<session>/<node>/<entity>/MP/<enclave>/<namespace>/<name>/<topic>/<type>/<hash>/<qos>`` |
| a message's attachment | number from 1 (int64), ns since 1970 (int64), 16 (a byte), the publisher's 16 bytes; little endian |

In tokens each ``/`` of a name is ``%``, and a missing name is ``%``. A publisher's 16 bytes are XXH3-128 of its
token, the low half first.

Source: ros2/rmw_zenoh, branch rolling, 2025: ``docs/design.md`` ("Topic and Service name mapping to Zenoh key
expressions", "Graph Cache", "Publishers"), and ``liveliness_utils.cpp``, ``attachment_helpers.cpp``, ``qos.cpp`` in
``rmw_zenoh_cpp/src/detail``. Its releases since April 2025 have this layout (Jazzy from 0.2.4, Kilted). Humble's
has no hashes of types.
"""  # noqa: E501

from __future__ import annotations

import re
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import zenoh

from hapnet.errors import BadMessage, InvalidParameter, MissingLibrary, TransportError
from hapnet.transport.config import ZenohSettings, reason, zenoh_config
from hapnet.transport.entities import call, direct

ROUTER = "tcp/localhost:7447"
"""The endpoint on which ``ros2 run rmw_zenoh_cpp rmw_zenohd`` listens."""

QOS = "::,10:,:,:,,"
"""Reliable, volatile, the last 10 are kept: rclpy's default. rmw_zenoh's own defaults are left out."""

_ATTACHMENT = struct.Struct("<qqB16s")
_NAME = re.compile(r"(/[A-Za-z_]\w*)+", re.ASCII)
_MOST_DOMAINS = 232


class Attachment(NamedTuple):
    """The attachment of each message: its number, when it was published [ns since 1970], and its publisher."""

    number: int
    time_ns: int
    publisher: bytes

    def encode(self) -> bytes:
        """Return its 33 bytes."""
        return _ATTACHMENT.pack(self.number, self.time_ns, len(self.publisher), self.publisher)

    @classmethod
    def decode(cls, data: bytes) -> Attachment:
        """Decode 33 bytes. Raises BadMessage: these bytes are no attachment."""
        if len(data) != _ATTACHMENT.size or data[16] != 16:
            raise BadMessage("attachment", f"{len(data)} bytes; allowed: {_ATTACHMENT.size}, as rmw_zenoh has them")
        number, time_ns, _, publisher = _ATTACHMENT.unpack(data)
        return cls(number, time_ns, publisher)


class Types:
    """The types of messages: their classes by name (``geometry_msgs/msg/Pose``), their hashes and their bytes.

    Raises MissingLibrary: a library of the extra is not installed.
    """

    def __init__(self) -> None:
        try:
            import xxhash
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise MissingLibrary("a ROS 2 node", missing(), "ros2") from error
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._digest: Callable[[bytes], int] = xxhash.xxh3_128_intdigest
        self.classes: Any = self._store.types

    def hash(self, kind: str) -> str:
        """Return the type's hash ``RIHS01_...`` (REP 2016)."""
        return self._store.hash_rihs01(kind)

    def encode(self, kind: str, message: Any) -> bytes:
        """Encode the message in CDR."""
        return bytes(self._store.serialize_cdr(message, kind))

    def decode(self, kind: str, data: bytes) -> Any:
        """Decode a message. Raises BadMessage: these bytes are no message of this type."""
        try:
            return self._store.deserialize_cdr(data, kind)
        except Exception as error:  # a stranger's bytes may cause any error
            raise BadMessage("cdr", f"no {kind}: {error}") from None

    def publisher(self, token: str) -> bytes:
        """The 16 bytes of the publisher with this token."""
        return self._digest(token.encode()).to_bytes(16, "little")


def missing() -> str:
    """The libraries of the extra that are not installed, with blanks between them."""
    from importlib.util import find_spec

    return " ".join(name for name in ("rosbags", "xxhash") if find_spec(name) is None)


def check_topic(name: str, value: str) -> str:
    """The value, if it is a fully qualified name of ROS; raises InvalidParameter otherwise."""
    if not _NAME.fullmatch(value):
        raise InvalidParameter(name, value, "a name of ROS that begins with /, such as /robot/target_pose")
    return value


def topic_key(domain: int, topic: str, kind: str, type_hash: str) -> str:
    """The key of a topic's messages."""
    return f"{domain}/{topic.strip('/')}/{_dds(kind)}/{type_hash}"


def node_token(domain: int, session: str, namespace: str, name: str) -> str:
    """The token of a node, the first of its session."""
    return f"@ros2_lv/{domain}/{session}/0/0/NN/%/{_mangled(namespace)}/{name}"


def endpoint_token(node: str, number: int, entity: str, topic: str, kind: str, type_hash: str) -> str:
    """The token of a publisher (entity MP) or subscription (MS) of the node with the token `node`."""
    head, _, names = node.partition("/0/0/NN/")
    return f"{head}/0/{number}/{entity}/{names}/{_mangled(topic)}/{_dds(kind)}/{type_hash}/{QOS}"


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def _dds(kind: str) -> str:
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


class RosNode:
    """A node that publishes and subscribes. It joins as a client of a router, which forwards to the nodes.

    name, namespace : those of the node. domain : ROS_DOMAIN_ID. router : a Zenoh endpoint. wall_ns : returns UTC [ns],
    for stamps only.

    Raises InvalidParameter, MissingLibrary.
    """

    def __init__(
        self,
        name: str,
        *,
        namespace: str = "/",
        domain: int = 0,
        router: str = ROUTER,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        if not 0 <= domain <= _MOST_DOMAINS:
            raise InvalidParameter("domain", domain, f"0 to {_MOST_DOMAINS}, as ROS_DOMAIN_ID")
        if namespace != "/":
            check_topic("namespace", namespace)
        self.types: Types = Types()
        self.router, self.domain = router, domain
        self._config = zenoh_config(ZenohSettings(mode="client", connect=(router,)))
        self._names = namespace, name
        self.wall_ns = wall_ns
        self._session: zenoh.Session | None = None
        self._token = ""
        self._count = 0
        self._kept: list[object] = []  # tokens, which end with the object
        self._publishers: dict[str, tuple[zenoh.Publisher, bytes, int]] = {}

    def open(self) -> None:
        """Join the network. Raises TransportError: the router does not answer."""
        try:
            session = zenoh.open(self._config)
            self._token = node_token(self.domain, str(session.zid()), *self._names)
            self._kept.append(session.liveliness().declare_token(self._token))
        except zenoh.ZError as error:
            text = f"no router of ROS 2 at {self.router}: `ros2 run rmw_zenoh_cpp rmw_zenohd` is one ({reason(error)})"
            raise TransportError(text) from None
        self._session = session

    def publish(self, topic: str, kind: str, message: Any) -> None:
        """Publish; from one thread at a time. It never waits; a message that the router does not accept is dropped."""
        session = self._opened()
        if topic not in self._publishers:
            token = self._declared(session, "MP", topic, kind)
            key = topic_key(self.domain, topic, kind, self.types.hash(kind))
            publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP, express=True)
            self._publishers[topic] = publisher, self.types.publisher(token), 0
        publisher, gid, number = self._publishers[topic]
        self._publishers[topic] = publisher, gid, number + 1
        attached = Attachment(number + 1, self.wall_ns(), gid).encode()
        with suppress(zenoh.ZError):  # the link is down, and comes back by itself
            publisher.put(self.types.encode(kind, message), attachment=attached)

    def subscribe(self, topic: str, kind: str, take: Callable[[bytes, bytes], object]) -> None:
        """Call `take` with each message's bytes and attachment, on one of Zenoh's threads; `take` must not block."""

        def receive(sample: zenoh.Sample) -> None:
            take(sample.payload.to_bytes(), b"" if sample.attachment is None else sample.attachment.to_bytes())

        session = self._opened()
        key = topic_key(self.domain, topic, kind, self.types.hash(kind))
        self._kept.append(session.declare_subscriber(key, direct(receive)))
        self._declared(session, "MS", topic, kind)

    def close(self, timeout_s: float = 2.0) -> None:
        """Leave the network. Over a lossy link Zenoh may take 10 s; closing then goes on in the background."""
        session, self._session = self._session, None
        if session is not None:
            closing = threading.Thread(target=call, args=(session.close,), daemon=True)
            closing.start()
            closing.join(timeout_s)

    def _opened(self) -> zenoh.Session:
        assert self._session is not None, "open comes first"
        return self._session

    def _declared(self, session: zenoh.Session, entity: str, topic: str, kind: str) -> str:
        self._count += 1
        token = endpoint_token(self._token, self._count, entity, topic, kind, self.types.hash(kind))
        self._kept.append(session.liveliness().declare_token(token))
        return token
