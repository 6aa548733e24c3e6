"""Zenoh's configuration: the flags of its own tools, and defaults for a stream of small messages at 1 kHz."""

from __future__ import annotations

import json
import re
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import zenoh

from hapnet.checks import one_of
from hapnet.errors import InvalidParameter, TransportError
from hapnet.transport.security import ANYBODY, ENCRYPTED, Security, is_exposed
from hapnet.wire.secret import Proof

Mode = Literal["peer", "client", "router"]
_LOOPBACK = "127.0.0.1"
_ANY_PORT = f"tcp/{_LOOPBACK}:0"
_PROTOCOLS = "tcp, udp, tls, quic, ws or unixsock-stream"
_ENDPOINT = re.compile(
    r"(?:(?:tcp|udp|tls|quic|ws)/(?:\[[^\]/]+\]|[^\s:/?#\[\]]+):(?P<port>\d{1,5})|unixsock-stream/[^\s?#]+)"
    r"(?:\?[^\s#]*)?(?:#\S*)?"
)

# Settings for a stream of small messages at 1 kHz. Each entry replaces Zenoh's own default, never a value from a file.
_DEFAULTS: dict[str, object] = {
    "scouting/gossip/enabled": False,
    "scouting/multicast/autoconnect_strategy": {"peer": {"to_peer": "greater-zid"}},  # only one of two peers dials
    "connect/timeout_ms": 1000,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 1.5},
    "transport/shared_memory/enabled": False,
    "transport/unicast/open_timeout": 1000,
    "transport/unicast/accept_timeout": 1000,
    "transport/link/tx/lease": 2000,
    # with 2, express messages are lost when the processor is busy
    "transport/link/tx/queue/size/real_time": 16,
    "transport/link/tx/queue/size/interactive_high": 16,
    "transport/link/tx/queue/size/interactive_low": 16,
    "transport/link/tx/queue/size/data_high": 16,
    "transport/link/tx/queue/size/data_low": 16,
    "transport/link/tx/queue/size/background": 16,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    # sixteen times the longest frame: Zenoh drops longer messages, and Python counts those that are just too long
    "low_pass_filter": [
        {"flows": ["ingress"], "messages": ["put"], "key_exprs": ["hapnet/**"], "size_limit": 65536},
    ],
}


End = Literal["connect", "listen"]
ENDS: tuple[End, End] = ("connect", "listen")


@dataclass(frozen=True, slots=True)
class ZenohSettings:
    """The settings that Zenoh's own tools take as flags.

    Attributes
    ----------
    mode : peer, client (of a router) or router. None: the file's, else peer.
    connect : endpoints to dial, such as ``tcp/192.168.0.2:17447``. Only one of two sides should dial.
    listen : endpoints to listen on. None given: a side that dials does not listen.
    config : path of a Zenoh configuration file, JSON5 or YAML.
    multicast_scouting : find peers on this machine by multicast; `cfg` may give it another interface.
    cfg : ``KEY:JSON5`` overrides, applied last.
    security : which nodes may connect.
    router : the settings of the router in this process through which this client reaches others. None: there is none.
    """

    mode: Mode | None = None
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    config: str | None = None
    multicast_scouting: bool = False
    cfg: tuple[str, ...] = ()
    security: Security = ANYBODY
    router: ZenohSettings | None = None


def zenoh_config(settings: ZenohSettings) -> zenoh.Config:
    """Zenoh's configuration for these settings: the file, then the flags, then `cfg`; hapnet's defaults for the rest.

    Raises InvalidParameter: Zenoh does not accept a mode, endpoint or override; there is no endpoint to dial or listen
    on, and no scouting; or the required security is not possible. TransportError: the file cannot be read, or is not a
    Zenoh configuration.
    """
    if settings.mode is not None:
        one_of("mode", settings.mode, get_args(Mode))
    for name, endpoints in (("connect", settings.connect), ("listen", settings.listen)):
        given: object = endpoints
        if isinstance(given, str):
            raise InvalidParameter(name, given, f"a tuple of endpoints: ({given!r},)")
        for endpoint in endpoints:
            check_endpoint(name, endpoint)
    settings.security.check()
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
    if settings.multicast_scouting and untouched("scouting/multicast/interface"):
        insert("scouting/multicast/interface", _LOOPBACK)
    for key, value in settings.security.entries(listens=bool(endpoints_of(config, "listen"))):
        insert(key, value)
    for item in settings.cfg:
        key, colon, text = item.partition(":")
        try:
            if not colon:
                raise InvalidParameter("cfg", item, "KEY:JSON5, such as transport/link/tx/lease:2000")
            config.insert_json5(key, text)
        except zenoh.ZError as error:
            raise InvalidParameter("cfg", item, f"KEY:JSON5 that Zenoh accepts ({reason(error)})") from None
    if config.get_json("transport/unicast/lowlatency") == "true" and untouched("transport/unicast/qos/enabled"):
        insert("transport/unicast/qos/enabled", False)  # Zenoh refuses to open with both
    nowhere = all(_endpoints(config, side) == [] for side in ("connect", "listen"))
    if nowhere and not scouts(config):
        why = "give an endpoint to dial (-e) or to listen on (-l), or allow multicast scouting"
        raise InvalidParameter("connect and listen", "are empty", "", why=why)
    _check_security(settings.security, config)
    return config


def zenoh_warnings(settings: ZenohSettings) -> tuple[str, ...]:
    """Warnings of the risks of these settings, one line each.

    Raises InvalidParameter, TransportError: as `zenoh_config`.
    """
    config = zenoh_config(settings)
    warnings = settings.security.warnings()
    exposed = [endpoint for endpoint in endpoints_of(config, "listen") if is_exposed(endpoint)]
    security = settings.security
    if exposed and security.secret_file is None:
        warnings += (
            f"listening on {', '.join(exposed)} without --secret-file: anyone who reaches it can pose as the other "
            "side, or intercept the pairing; use --secret-file, tls/ or quic/ with --tls-cert, --tls-key, "
            "--tls-ca and --mutual-tls, or 127.0.0.1",
        )
    elif exposed and not security.encrypt:
        warnings += (
            f"listening on {', '.join(exposed)} without --encrypt: anyone who reaches it can read the telemetry, and "
            "a peer that cannot encrypt is accepted",
        )
    return warnings


def endpoints_of(config: zenoh.Config, side: End) -> list[str]:
    """The endpoints that a configuration dials or listens on, in any of its forms."""
    return list(_flat(_endpoints(config, side), json.loads(config.get_json("mode"))))


def proof_of(settings: ZenohSettings) -> Proof | None:
    """Return the proof, besides a word, of the identity of the nodes on this side's links; None: there is none.

    Certificates are a proof if each link requires them of both ends, or a password of one end; so is a socket that only
    this machine's user can open. This side cannot check what the other side's links require. For a client of a router
    in this process, the router's links count.

    Raises InvalidParameter, TransportError: as `zenoh_config`.
    """
    settings = settings.router or settings
    config, security = zenoh_config(settings), settings.security
    protocols = {each.partition("/")[0] for side in ENDS for each in endpoints_of(config, side)}
    if scouts(config):
        return None
    if protocols <= {"unixsock-stream"}:
        return "socket"
    requires_proof = _is_mutual(config) or security.users is not None or security.user is not None
    return "certificate" if requires_proof and protocols <= {*ENCRYPTED, "unixsock-stream"} else None


def may_lose(config: zenoh.Config) -> bool:
    """Whether there is an endpoint without retransmission, so that a message that is sent once may never arrive."""
    endpoints = endpoints_of(config, "listen") + endpoints_of(config, "connect")
    return any(endpoint.startswith("udp/") or "rel=0" in endpoint for endpoint in endpoints)


def _flat(value: object, mode: str) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):  # several ways to one node, or a table by mode
        yield from _flat(value.get("locators", value.get(mode)), mode)
    elif isinstance(value, list):
        for item in value:
            yield from _flat(item, mode)


def _check_security(security: Security, config: zenoh.Config) -> None:
    """Checks that need all endpoints, including those of the file and of `cfg`."""
    listens, dials = endpoints_of(config, "listen"), endpoints_of(config, "connect")
    for side, endpoints in (("listen", listens), ("connect", dials)):
        for endpoint in endpoints:
            if security.tls_flag is not None and endpoint.partition("/")[0] not in ENCRYPTED:
                raise InvalidParameter(side, endpoint, f"tls/ or quic/ ADDRESS:PORT, with {security.tls_flag}")
    for endpoint in listens:
        if endpoint.partition("/")[0] in ENCRYPTED and "#" not in endpoint and not _has_certificate(config):
            raise InvalidParameter("listen", endpoint, "", why="it needs a certificate: --tls-cert and --tls-key")
    if security.tls_ca is not None and listens and not dials and not _is_mutual(config):
        why = "a side that only listens checks certificates with --mutual-tls only; add it"
        raise InvalidParameter("--tls-ca", security.tls_ca, "", why=why)
    if security.users is not None and not listens:
        raise InvalidParameter("--users", security.users, "", why="it belongs to the side that listens (-l)")
    if security.user is not None and not dials and not scouts(config):
        why = "it belongs to the side that dials (-e); the side that listens has --users"
        raise InvalidParameter("--user", security.user, "", why=why)


def _is_mutual(config: zenoh.Config) -> bool:
    return bool(config.get_json("transport/link/tls/enable_mtls") == "true")


def _has_certificate(config: zenoh.Config) -> bool:
    key = "transport/link/tls/listen_certificate"
    return any(config.get_json(key + form) != "null" for form in ("", "_base64"))


def scouts(config: zenoh.Config) -> bool:
    return bool(config.get_json("scouting/multicast/enabled") == "true")


def check_endpoint(name: str, value: str) -> None:
    match = _ENDPOINT.fullmatch(value)
    if match is None or int(match["port"] or 0) > 65535:
        allowed = f"PROTOCOL/ADDRESS:PORT, such as tcp/127.0.0.1:17447, the protocol {_PROTOCOLS}"
        raise InvalidParameter(name, value, allowed)


def _endpoints(config: zenoh.Config, side: str) -> object:
    """A list of endpoints; in a file it may also be a table by mode, or contain groups."""
    return json.loads(config.get_json(f"{side}/endpoints"))


def where(config: zenoh.Config) -> str:
    """Describe in words where a side listens, which endpoints it dials and whether it scouts."""
    words = []
    for side, verb in (("listen", "listening on"), ("connect", "dialling")):
        endpoints = _endpoints(config, side)
        if isinstance(endpoints, list) and endpoints:
            words.append(f"{verb} {', '.join(map(str, endpoints))}")
        elif endpoints:
            words.append(f"{verb} {json.dumps(endpoints)}")
    if scouts(config):
        words.append("scouting by multicast")
    return ", ".join(words)


def reason(error: zenoh.ZError) -> str:
    """Zenoh's message in one line, without the places in its source and the names of its error types."""
    text = " ".join(re.sub(r" at \S+\.rs:\d+\.?", "", str(error)).split())
    inner = re.search(r'msg: "(.*)", location', text) or re.search(r'Str\("(.*)"\)', text)
    return (inner[1] if inner else text).replace("\\n", " ").strip()


def local_address(directory: str) -> str:
    """An endpoint for two processes on this machine: a Unix socket in `directory`, which only its user should enter.

    Its latency is 0.8 to 0.9 times that of tcp. The endpoint is tcp if Zenoh or the system does not accept the path.
    """
    fits = sys.platform != "win32" and re.fullmatch(r"[^\s?#]{1,90}", directory)
    return f"unixsock-stream/{directory}/link" if fits else free_address()


def listen_here_too(config: zenoh.Config, address: str) -> None:
    """Let a configuration listen at the `local_address` of its own program too, whatever its links must prove."""
    config.insert_json5("listen/endpoints", json.dumps([*endpoints_of(config, "listen"), address]))
    protocols = json.loads(config.get_json("transport/link/protocols"))
    if protocols:
        config.insert_json5("transport/link/protocols", json.dumps([*protocols, address.partition("/")[0]]))


def free_address(protocol: str = "tcp") -> str:
    """An endpoint on this machine that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"
