"""Zenoh's configuration from the flags that its own tools take, with what suits a stream of small messages at 1 kHz."""

from __future__ import annotations

import json
import re
import socket
from dataclasses import dataclass
from typing import Literal

import zenoh

from hapnet.errors import InvalidParameter, TransportError

Mode = Literal["peer", "client", "router"]
_MODES = ("peer", "client", "router")
_ANY_PORT = "tcp/[::]:0"
_PROTOCOLS = "tcp, udp, tls, quic, ws or unixsock-stream"
_ENDPOINT = re.compile(
    r"(?:(?:tcp|udp|tls|quic|ws)/(?:\[[^\]/]+\]|[^\s:/?#\[\]]+):(?P<port>\d{1,5})|unixsock-stream/[^\s?#]+)"
    r"(?:\?[^\s#]*)?(?:#\S*)?"
)

# What suits a stream of small messages at 1 kHz; each replaces Zenoh's own default, never what a file sets otherwise.
_DEFAULTS: dict[str, object] = {
    "scouting/gossip/enabled": False,
    "scouting/multicast/autoconnect_strategy": {"peer": {"to_peer": "greater-zid"}},  # only one of two peers dials
    "connect/timeout_ms": 1000,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
    "transport/shared_memory/enabled": False,
    "transport/unicast/open_timeout": 1000,
    "transport/unicast/accept_timeout": 1000,
    "transport/link/tx/lease": 2000,
    "transport/link/tx/queue/size/real_time": 16,  # with 2, express messages are lost when the processor is busy
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}


@dataclass(frozen=True, slots=True)
class ZenohSettings:
    """What Zenoh's own tools take as flags.

    Attributes
    ----------
    mode : peer, client (of a router) or router. None: what the file says, else peer.
    connect : endpoints to dial, such as ``tcp/192.168.0.2:17447``. Only one of two sides should dial.
    listen : endpoints to listen on. None given: a side that dials does not listen.
    config : path of a Zenoh configuration file, JSON5 or YAML.
    multicast_scouting : find peers on the local network by multicast.
    cfg : ``KEY:JSON5`` overrides, applied last.
    """

    mode: Mode | None = None
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    config: str | None = None
    multicast_scouting: bool = False
    cfg: tuple[str, ...] = ()


def zenoh_config(settings: ZenohSettings) -> zenoh.Config:
    """Zenoh's configuration for these settings: file, then flags, then `cfg`; hapnet's defaults where none says a word.

    Raises
    ------
    InvalidParameter : a mode, endpoint or override that Zenoh would not take, or nowhere to dial, listen or scout.
    TransportError : the file cannot be read, or is not a Zenoh configuration.
    """
    if settings.mode is not None and settings.mode not in _MODES:
        raise InvalidParameter("mode", settings.mode, "one of " + ", ".join(_MODES))
    for name, endpoints in (("connect", settings.connect), ("listen", settings.listen)):
        for endpoint in endpoints:
            _check_endpoint(name, endpoint)
    plain = zenoh.Config()
    try:
        config = zenoh.Config() if settings.config is None else zenoh.Config.from_file(settings.config)
    except zenoh.ZError as error:
        raise TransportError(f"config file {settings.config!r} is not usable: {reason(error)}") from None

    def untouched(key: str) -> bool:
        return bool(config.get_json(key) == plain.get_json(key))

    def insert(key: str, value: object) -> None:
        config.insert_json5(key, json.dumps(value))

    for key, value in _DEFAULTS.items():
        if untouched(key):
            insert(key, value)
    if settings.mode is not None or untouched("mode"):
        insert("mode", settings.mode or "peer")
    if settings.multicast_scouting or untouched("scouting/multicast/enabled"):
        insert("scouting/multicast/enabled", settings.multicast_scouting)
    if settings.connect:
        insert("connect/endpoints", settings.connect)
    if settings.listen or untouched("listen/endpoints"):
        # Zenoh's default would listen on every interface
        scouts_only = settings.multicast_scouting and not settings.connect and settings.mode != "client"
        insert("listen/endpoints", settings.listen or ([_ANY_PORT] if scouts_only else []))
    for item in settings.cfg:
        key, colon, text = item.partition(":")
        try:
            if not colon:
                raise InvalidParameter("cfg", item, "KEY:JSON5, such as transport/link/tx/lease:2000")
            config.insert_json5(key, text)
        except zenoh.ZError as error:
            raise InvalidParameter("cfg", item, f"KEY:JSON5 that Zenoh accepts ({reason(error)})") from None
    nowhere = all(_endpoints(config, side) == [] for side in ("connect", "listen"))
    if nowhere and config.get_json("scouting/multicast/enabled") != "true":
        raise InvalidParameter(
            "connect", settings.connect, "an endpoint to dial or to listen on, or multicast scouting"
        )
    return config


def _check_endpoint(name: str, value: str) -> None:
    match = _ENDPOINT.fullmatch(value)
    if match is None or int(match["port"] or 0) > 65535:
        allowed = f"PROTOCOL/ADDRESS:PORT, such as tcp/127.0.0.1:17447, the protocol {_PROTOCOLS}"
        raise InvalidParameter(name, value, allowed)


def _endpoints(config: zenoh.Config, side: str) -> object:
    """A list of endpoints; in a file it may also be a table by mode, or a list of lists."""
    return json.loads(config.get_json(f"{side}/endpoints"))


def where(config: zenoh.Config) -> str:
    words = []
    for side, verb in (("listen", "listening on"), ("connect", "dialling")):
        endpoints = _endpoints(config, side)
        if isinstance(endpoints, list) and endpoints:
            words.append(f"{verb} {', '.join(map(str, endpoints))}")
        elif endpoints:
            words.append(f"{verb} {json.dumps(endpoints)}")
    if config.get_json("scouting/multicast/enabled") == "true":
        words.append("scouting by multicast")
    return ", ".join(words)


def reason(error: zenoh.ZError) -> str:
    """What Zenoh says, in one line, without the places in its source and the names of its error types."""
    text = " ".join(re.sub(r" at \S+\.rs:\d+\.?", "", str(error)).split())
    inner = re.search(r'msg: "(.*)", location', text) or re.search(r'Str\("(.*)"\)', text)
    return (inner[1] if inner else text).replace("\\n", " ").strip()


def free_address() -> str:
    """An endpoint on this machine that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
