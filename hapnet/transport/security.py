"""The security of connections: the flags for TLS, mutual TLS, users and passwords, and the checks of their files.

A side that listens shows its certificate. With mutual TLS it also requires a certificate from the side that dials,
signed by the same authority. User and password identify the side that dials, over TLS or not.
"""

from __future__ import annotations

import contextlib
import re
import ssl
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path

from hapnet.errors import InvalidParameter

PASSWORD_VARIABLE = "HAPNET_PASSWORD"
"""The environment variable from which the commands take a password."""

ENCRYPTED = ("tls", "quic")
"""Zenoh's protocols to which the TLS flags apply."""

UNTIMELY = {10: "has expired", 9: "is not valid yet"}
"""OpenSSL's X509_V_ERR_CERT_HAS_EXPIRED and X509_V_ERR_CERT_NOT_YET_VALID as text."""

MIN_SECRET = 8
"""The fewest characters of a secret."""

_LOCAL = ("unixsock-stream", "unixpipe", "serial", "vsock")
_NAME = re.compile(r"[^\s:#][^\s:]*")
_USER = re.compile(rf"(?P<name>{_NAME.pattern}):\S.*")


@dataclass(frozen=True, slots=True)
class Security:
    """The settings that decide which nodes may connect.

    Attributes
    ----------
    tls_ca : certificate of the authority that must have signed the other side's certificate; None: the public ones.
    tls_cert, tls_key : this side's certificate and its key, both PEM; the key without a passphrase.
    mutual_tls : a side that listens requires a certificate from the side that dials. A side that only dials always
        shows its certificate.
    user : this side's name when it dials; its password is the first line of `password_file`, or `password`.
    users : on the side that listens, a file of lines ``user:password``: the users who may dial.
    secret_file : its first line is a word that only both sides have; it is part of the key of
        `hapnet.wire.secret`. This needs no certificates.
    encrypt : pair only with a side that can encrypt, and encrypt what the two sides send (`hapnet.wire.encryption`).
    """

    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    mutual_tls: bool = False
    user: str | None = None
    password_file: Path | None = None
    password: str | None = field(default=None, repr=False)
    users: Path | None = None
    secret_file: Path | None = None
    encrypt: bool = False

    def secret_word(self) -> str:
        """The first line of `secret_file`; empty if there is none.

        Raises InvalidParameter: the file cannot be read, or its first line is shorter than `MIN_SECRET` characters.
        """
        if self.secret_file is None:
            return ""
        word = _first_line("--secret-file", self.secret_file)
        if len(word) < MIN_SECRET:  # the message must not show the line
            allowed = f"a file whose first line has {MIN_SECRET} characters or more"
            raise InvalidParameter("--secret-file", str(self.secret_file), allowed)
        return word

    @property
    def tls_flag(self) -> str | None:
        """The first given flag that requires TLS; None if none is given."""
        given = {
            "--tls-ca": self.tls_ca is not None,
            "--tls-cert": self.tls_cert is not None,
            "--tls-key": self.tls_key is not None,
            "--mutual-tls": self.mutual_tls,
        }
        return next((flag for flag, is_given in given.items() if is_given), None)

    def check(self) -> None:
        """Read every file and check that it is what its flag requires.

        Raises InvalidParameter: a file is missing, is not what its flag requires or has expired, or flags do not fit
        together.
        """
        _check_certificates(self)
        _check_users(self)
        self.secret_word()

    def entries(self, *, listens: bool) -> Iterator[tuple[str, object]]:
        """The keys and values for Zenoh's configuration; call `check` before.

        listens : whether this side listens; if so, it shows its certificate on dialling only with `mutual_tls`.
        """
        tls = "transport/link/tls"
        files = (
            (self.tls_ca, ("root_ca_certificate",)),
            (self.tls_cert, ("listen_certificate", "connect_certificate")),
            (self.tls_key, ("listen_private_key", "connect_private_key")),
        )
        for path, names in files:
            if path is not None:
                for name in names:
                    yield f"{tls}/{name}_base64", None  # Zenoh would prefer this one
                    yield f"{tls}/{name}", str(path)
        if self.mutual_tls or (self.tls_cert is not None and not listens):
            yield f"{tls}/enable_mtls", True
        if self.tls_flag is not None:
            yield "transport/link/protocols", list(ENCRYPTED)  # a peer found by scouting offers others too
        if self.user is not None:
            yield "transport/auth/usrpwd/user", self.user
            yield "transport/auth/usrpwd/password", self.known_password()
        if self.users is not None:
            yield "transport/auth/usrpwd/dictionary_file", str(self.users)

    def warnings(self) -> tuple[str, ...]:
        """Warnings about files with secrets that other users of this machine can read."""
        secret = (
            ("--tls-key", self.tls_key),
            ("--password-file", self.password_file),
            ("--users", self.users),
            ("--secret-file", self.secret_file),
        )
        return tuple(
            f"{flag} {path} can be read by others: chmod 600 {path}"
            for flag, path in secret
            if path is not None and path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH)
        )

    def known_password(self) -> str | None:
        if self.password_file is None:
            return self.password
        return _first_line("--password-file", self.password_file)  # as Zenoh reads users


ANYBODY = Security()
"""No security: anybody may connect, and nothing is encrypted."""


def is_exposed(endpoint: str) -> bool:
    """Whether others than this machine's users can read and send if a side listens there; True for an unknown host
    name.
    """
    protocol, _, address = endpoint.partition("/")
    if protocol in ENCRYPTED or protocol in _LOCAL:
        return False
    host = host_and_port(address)[0]
    try:
        return not ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"


def host_and_port(address: str) -> tuple[str, str]:
    """Host and port of ``HOST:PORT``, without Zenoh's options after ``?`` and ``#``; an IPv6 host is in brackets."""
    host, _, port = re.split(r"[?#]", address)[0].rpartition(":")
    return host.removeprefix("[").removesuffix("]"), port


def _check_certificates(security: Security) -> None:
    ca, cert, key = security.tls_ca, security.tls_cert, security.tls_key
    if cert is not None and key is None:
        raise InvalidParameter("--tls-cert", cert, "", why="it needs its key, --tls-key FILE")
    if key is not None and cert is None:
        raise InvalidParameter("--tls-key", key, "", why="it needs its certificate, --tls-cert FILE")
    if security.mutual_tls and (ca is None or cert is None):
        raise InvalidParameter("--mutual-tls", "alone", "", why="it needs --tls-ca, --tls-cert and --tls-key")
    if ca is not None:
        _trust("--tls-ca", ca)
    if cert is not None and key is not None:
        _check_pair(cert, key)


def _check_pair(cert: Path, key: Path) -> None:
    trust = _trust("--tls-cert", cert)
    _read("--tls-key", key)
    own = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        own.load_cert_chain(cert, key, password=lambda: b"")  # without a password OpenSSL would ask the terminal
    except ssl.SSLError as error:
        wrong = f"it is not the key of {cert}"
        why = wrong if error.reason == "KEY_VALUES_MISMATCH" else "it is not a private key in PEM without a passphrase"
        raise InvalidParameter("--tls-key", key, "", why=why) from None
    refused = _shown_to(trust, own)
    if refused in UNTIMELY:
        raise InvalidParameter("--tls-cert", cert, "", why=f"the certificate {UNTIMELY[refused]}")


def _shown_to(trust: ssl.SSLContext, own: ssl.SSLContext) -> int:
    """Verify a certificate by a handshake in memory; returns OpenSSL's code of its fault, 0 if it has none."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = trust.wrap_bio(to_client, to_server)
    server = own.wrap_bio(to_server, to_client, server_side=True)
    try:
        for end in (client, server, client, server):
            with contextlib.suppress(ssl.SSLWantReadError):
                end.do_handshake()
    except ssl.SSLCertVerificationError as error:
        return error.verify_code
    except ssl.SSLError:
        return 0  # any other fault is between the two sides: the side that dials reports it
    return 0


def _trust(flag: str, path: Path) -> ssl.SSLContext:
    """A context that trusts the certificates in a file, leaf certificates too, for any host."""
    _read(flag, path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_flags |= ssl.VerifyFlags.VERIFY_X509_PARTIAL_CHAIN
    try:
        context.load_verify_locations(path)
    except ssl.SSLError:
        raise InvalidParameter(flag, str(path), "a file with a certificate in PEM") from None
    return context


def _check_users(security: Security) -> None:
    user = security.user
    if user is None and security.password_file is not None:
        raise InvalidParameter("--password-file", security.password_file, "", why="it needs --user NAME")
    if user is not None:
        if not _NAME.fullmatch(user):
            raise InvalidParameter("--user", user, "a name without spaces and colons, and no # at its start")
        if not security.known_password():
            why = f"it needs its password: --password-file FILE, or {PASSWORD_VARIABLE} in the environment"
            raise InvalidParameter("--user", user, "", why=why)
    if security.users is not None:
        _check_dictionary(security.users)


def _check_dictionary(path: Path) -> None:
    names: set[str] = set()
    for number, line in enumerate(_read("--users", path).splitlines(), 1):
        match = _USER.fullmatch(line)
        if match is None or match["name"] in names:
            wrong = (
                "is not user:password" if match is None else "names a user again"
            )  # the line itself may hold a password
            raise InvalidParameter("--users", path, "", why=f"line {number} {wrong}")
        names.add(match["name"])
    if not names:
        raise InvalidParameter("--users", path, "", why="it is empty; write lines user:password")


def _first_line(flag: str, path: Path) -> str:
    return next(iter(_read(flag, path).splitlines()), "").strip()


def _read(flag: str, path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = "not text" if isinstance(error, UnicodeDecodeError) else error.strerror
        raise InvalidParameter(flag, str(path), f"a file that can be read ({why})") from None
