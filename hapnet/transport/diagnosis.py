"""Diagnose why no listener answers, by a separate TLS handshake, since Zenoh reports only "Timeout!".

The probe repeats Zenoh's first steps with the same certificates, and hangs up. It sends no data to the listening Zenoh
node, which drops the connection as that of a node that has left.
"""

from __future__ import annotations

import contextlib
import json
import socket
import ssl
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import zenoh

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.transport.config import ZenohSettings, check_endpoint, endpoints_of, scouts, zenoh_config
from hapnet.transport.security import UNTIMELY, host_and_port

REFUSAL_S = 0.5
"""With TLS 1.3 a refused certificate shows only after the handshake; the longest wait for that [s]."""

UNANSWERED_NS = 3_000_000_000
"""The first probe is made when there was no answer for this time [ns]."""

ASK_EVERY_NS = 10_000_000_000
PROBE_S = 2.0
"""The approximate total time of the probes of one diagnosis [s]."""

LOOK_UP_S = 2.0
"""The longest wait for a host's address before the first connection [s]."""

_NO_HOST = {socket.EAI_NONAME, getattr(socket, "EAI_NODATA", socket.EAI_NONAME)}
"""The resolver's codes for a name that has no address; others, such as EAI_AGAIN, are for now."""

_OVER_TCP = ("tcp/", "tls/", "ws/")
_WRONG_NAME, _WRONG_ADDRESS = 62, 64  # OpenSSL's X509_V_ERR_*
_NOT_SIGNED = (2, 7, 18, 19, 20, 21)  # no issuer, another issuer of the same name, or a self-signed certificate
_SIGNED_BY_ANOTHER = ("UNKNOWN_CA", "DECRYPT_ERROR", "BAD_CERTIFICATE")  # of the same name or not
_HANG_UPS = (ssl.SSLEOFError, ssl.SSLZeroReturnError, ConnectionResetError, BrokenPipeError)


@dataclass(frozen=True, slots=True)
class Trust:
    """The certificates that a dialling side trusts and shows, from Zenoh's configuration."""

    ca: str | None = None
    certificate: str | None = None
    key: str | None = None
    check_name: bool = True
    inline: bool = False
    """The certificates are in the configuration itself, which the probe does not read."""

    @staticmethod
    def of(config: zenoh.Config) -> Trust:
        """Read from a configuration."""

        def value(name: str) -> object:
            return json.loads(config.get_json(f"transport/link/tls/{name}"))

        def file(name: str) -> str | None:
            path = value(name)
            return path if isinstance(path, str) else None

        shows = value("enable_mtls") is True
        return Trust(
            file("root_ca_certificate"),
            file("connect_certificate") if shows else None,
            file("connect_private_key") if shows else None,
            value("verify_name_on_connect") is not False,
            any(value(f"{name}_base64") for name in ("root_ca_certificate", "connect_certificate")),
        )


def why_unanswered(settings: ZenohSettings, timeout_s: float) -> str | None:
    """Return why there is no connection, in one line; None if probes find no reason (as with quic/ and udp/).

    Blocks for about `timeout_s` at most, so it needs a thread of its own.

    Raises InvalidParameter, TransportError: as `zenoh_config`.
    """
    config = zenoh_config(settings)
    dialled = endpoints_of(config, "connect")
    if not dialled:
        return _why_nobody_came(endpoints_of(config, "listen"), scouts=scouts(config))
    endpoints = [endpoint for endpoint in dialled if endpoint.startswith(_OVER_TCP)]
    trust = Trust.of(config)
    reasons = []
    for endpoint in endpoints:
        reason = probe(endpoint, trust, timeout_s / len(endpoints)) or _not_zenohs(settings)
        reasons.append(f"{endpoint}: {reason}")
    return "; ".join(reasons) or None


def _why_nobody_came(listens: Sequence[str], *, scouts: bool) -> str | None:
    """Describe how the other side can reach this one, which dials nobody."""
    if scouts:
        return (
            "no node answers by multicast: if the other side runs, a network blocks it; then give one side "
            "-l tcp/0.0.0.0:17447, and the other -e tcp/HOST:17447"
        )
    hosts = [
        host_and_port(endpoint.partition("/")[2])[0] for endpoint in listens if not endpoint.startswith("unixsock-")
    ]
    if hosts and all(host == "localhost" or host == "::1" or host.startswith("127.") for host in hosts):
        return f"only programs on this host can dial {' or '.join(hosts)}: for others listen on 0.0.0.0"
    if hosts:
        return "nobody has dialled: the other side needs -e with this host's address, and a firewall must let it in"
    return None


class ConnectionDiagnosis:
    """Diagnoses at intervals why there is no answer, on a thread of its own; no other thread waits for it.

    settings : those of the connection. now_ns : the time since which there is no answer.
    """

    def __init__(self, settings: ZenohSettings, now_ns: int) -> None:
        self._settings = settings
        self._next_ns = now_ns + UNANSWERED_NS
        self._thread: threading.Thread | None = None
        self._answer = ""

    def answer(self, now_ns: int) -> str:
        """The last diagnosis; empty until there is one."""
        if now_ns >= self._next_ns and (self._thread is None or not self._thread.is_alive()):
            self._next_ns = now_ns + ASK_EVERY_NS
            self._thread = threading.Thread(target=self._diagnose, name="diagnosis", daemon=True)
            self._thread.start()
        return self._answer

    def close(self) -> None:
        """Wait for a running probe, a few seconds at most."""
        if self._thread is not None:
            self._thread.join(2.0 * PROBE_S)

    def _diagnose(self) -> None:
        with contextlib.suppress(HapnetError):  # the settings were checked, but a file may be gone since then
            self._answer = why_unanswered(self._settings, PROBE_S) or ""


def check_hosts(endpoints: Iterable[str]) -> None:
    """Look up the hosts to dial. A look-up that fails for now, or takes long, is left to the connection's retries.

    Raises InvalidParameter: an endpoint is malformed, or its host has no address.
    """
    for endpoint in endpoints:
        check_endpoint("connect", endpoint)
        protocol, _, address = endpoint.partition("/")
        if protocol == "unixsock-stream":
            continue
        host, _ = host_and_port(address)
        failed: list[socket.gaierror] = []
        thread = threading.Thread(target=_look_up, args=(host, failed), name="look-up", daemon=True)
        thread.start()
        thread.join(LOOK_UP_S)
        if failed and failed[0].errno in _NO_HOST:
            raise InvalidParameter("connect", endpoint, "", why=f"no such host: {host} ({failed[0].strerror})")


def _look_up(host: str, failed: list[socket.gaierror]) -> None:
    try:
        socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except socket.gaierror as error:
        failed.append(error)
    except UnicodeError:  # a name that no host can have, as a..b
        failed.append(socket.gaierror(socket.EAI_NONAME, "not a host's name"))


def probe(endpoint: str, trust: Trust, timeout_s: float) -> str | None:
    """Connect to a tls/ or tcp/ endpoint, with a handshake for tls/; returns why that fails, or None.

    Each of these two steps waits up to `timeout_s` for a listener that neither answers nor hangs up.
    """
    protocol, _, address = endpoint.partition("/")
    host, port = host_and_port(address)
    try:
        with socket.create_connection((host, port), timeout_s) as connection:
            if protocol == "tls" and not trust.inline:
                return _shake_hands(connection, host, trust, timeout_s)
    except ConnectionRefusedError:
        return "no program listens there"
    except socket.gaierror as error:
        no_host = error.errno in _NO_HOST
        return f"{'no such host' if no_host else f'the host {host} cannot be looked up now'} ({error.strerror})"
    except TimeoutError:
        return f"no answer within {timeout_s:g} s: a wrong address, or a firewall"
    except OSError as error:
        return f"cannot be reached ({error.strerror or error})"
    return None


def _shake_hands(connection: socket.socket, host: str, trust: Trust, timeout_s: float) -> str | None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = trust.check_name
    shown = False
    try:
        if trust.ca is None:
            context.load_default_certs()
        else:
            context.load_verify_locations(trust.ca)
        if trust.certificate is not None and trust.key is not None:
            context.load_cert_chain(trust.certificate, trust.key, password=lambda: b"")
            shown = True
        with context.wrap_socket(connection, server_hostname=host) as wrapped:
            wrapped.settimeout(min(timeout_s, REFUSAL_S))
            try:
                hung_up = not wrapped.recv(1)
            except TimeoutError:
                return None  # the listener waits for data: all is well
            return "the listener hangs up after the handshake" if hung_up else None
    except ssl.SSLCertVerificationError as error:
        return _distrusted(error, host, trust)
    except _HANG_UPS:
        return "the listener hangs up: it may not use TLS (tcp/ instead of tls/?)"
    except TimeoutError:
        return "the listener does not answer the handshake: it may not use TLS (tcp/ instead of tls/?), or is busy"
    except ssl.SSLError as error:
        return _refused(error.reason or str(error), shown=shown)


def _distrusted(error: ssl.SSLCertVerificationError, host: str, trust: Trust) -> str:
    code = error.verify_code
    if code in _NOT_SIGNED:
        by = "--tls-ca" if trust.ca is not None else "a public authority: give --tls-ca"
        return f"the listener's certificate is not signed by {by}"
    if code in (_WRONG_NAME, _WRONG_ADDRESS):
        return f"the listener's certificate is for another name than {host}: dial a name that is in it"
    if code in UNTIMELY:
        return f"the listener's certificate, or --tls-ca, {UNTIMELY[code]}"
    return f"the listener's certificate is refused ({error.verify_message})"


def _refused(reason: str, *, shown: bool) -> str:
    """Describe why the listener refuses this side. reason : OpenSSL's. shown : this side has shown a certificate."""
    version, _, alert = reason.partition("_ALERT_")
    if not alert:
        return f"the listener does not use TLS ({_words(version)}; tcp/ instead of tls/?)"
    if not shown:
        if alert in ("CERTIFICATE_REQUIRED", "HANDSHAKE_FAILURE"):
            return "the listener requires a certificate: give --tls-cert and --tls-key"
        return f"the listener refuses this side ({_words(alert)})"
    why = "it is not signed by the listener's --tls-ca" if alert in _SIGNED_BY_ANOTHER else _words(alert)
    return f"the listener refuses the certificate of --tls-cert: {why}"


def _words(reason: str) -> str:
    return reason.replace("_", " ").lower()


def _not_zenohs(settings: ZenohSettings) -> str:
    """Return the possible cause if the connection itself works."""
    if settings.security.user is not None:
        return "the listener does not accept this side: user or password may be wrong, or it has no --users"
    return "the listener does not accept this side: it may require --user and a password, or not be Zenoh"
