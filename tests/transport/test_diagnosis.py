"""What is said of a listener that lets nobody in: of real Zenoh listeners, and of others that are harder to make."""

import asyncio
import contextlib
import socket
import socketserver
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from examples.secure.make_certificates import issue, save
from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.diagnosis import Trust, probe, why_unanswered
from hapnet.transport.security import Security
from tests.support.transports import Side, assert_exchange, opened, own, paired

LIMIT_S = 5.0


async def why(endpoint: str, security: Security, timeout_s: float = LIMIT_S) -> str | None:
    settings = ZenohSettings(connect=(endpoint,), security=security)
    return await asyncio.to_thread(why_unanswered, settings, timeout_s)


@contextlib.contextmanager
def serving(context: ssl.SSLContext | None, say: bytes | None) -> Iterator[str]:
    """Something that listens, says `say` and hangs up; with None it says nothing until the other hangs up."""

    class Answer(socketserver.BaseRequestHandler):
        request: socket.socket

        def handle(self) -> None:
            with contextlib.suppress(OSError):  # the other has hung up, or been refused
                connection = self.request if context is None else context.wrap_socket(self.request, server_side=True)
                with connection:
                    if say is None:
                        while connection.recv(1024):
                            pass
                    else:
                        connection.sendall(say)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"tls/127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def server_context(certificates: Path, name: str = "world", version: ssl.TLSVersion | None = None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificates / f"{name}.pem", certificates / f"{name}.key")
    if version is not None:
        context.maximum_version = version
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(certificates / "ca.pem")
    return context


# A world with mutual TLS

NO_CERTIFICATE = "the listener requires a certificate: give --tls-cert and --tls-key"
OTHER_AUTHORITY = "the listener refuses the certificate of --tls-cert: it is not signed by the listener's --tls-ca"
WRONG_ROOT = "the listener's certificate is not signed by --tls-ca"


async def test_what_a_world_with_mutual_tls_refuses(certificates: Path) -> None:
    endpoint = free_address("tls")
    right = own(certificates, "alice")
    assert await why(endpoint, right) == f"{endpoint}: no program listens there"
    world = Side("world", ZenohSettings(listen=(endpoint,), security=own(certificates, "world", mutual=True)))
    async with opened(world):
        assert await why(endpoint, Security(certificates / "ca.pem")) == f"{endpoint}: {NO_CERTIFICATE}"
        assert await why(endpoint, own(certificates, "other/alice")) == f"{endpoint}: {OTHER_AUTHORITY}"
        assert await why(endpoint, own(certificates, "alice", ca="other")) == f"{endpoint}: {WRONG_ROOT}"
        said = await why(endpoint, Security())
        assert said == f"{endpoint}: the listener's certificate is not signed by a public authority: give --tls-ca"
        other_host = endpoint.replace("127.0.0.1", "localhost")
        said = await why(other_host, right)
        assert "the listener does not accept this side" in said  # the certificates are in order


async def test_a_probe_does_not_disturb_a_pair(certificates: Path) -> None:
    endpoint = free_address("tls")
    world = Side("world", ZenohSettings(listen=(endpoint,), security=own(certificates, "world", mutual=True)))
    device = Side("device", ZenohSettings(connect=(endpoint,), security=own(certificates, "alice")))
    async with opened(world, device):
        await paired(world, device)
        for side in (world, device):
            side.changed.clear()
        probes = [why(endpoint, own(certificates, name)) for name in ("alice", "bob", "other/alice") * 5]
        said = asyncio.gather(*probes)
        while not said.done():
            await assert_exchange(world, device)
        assert all(await said)
        assert not device.changed.is_set()
        assert (world.transport.partners, device.transport.partners) == (1, 1)
    again = Side("world", ZenohSettings(listen=(endpoint,), security=own(certificates, "world", mutual=True)))
    async with opened(again):
        pass  # no probe keeps the port


# Other listeners


def test_a_name_that_is_not_in_the_certificate(certificates: Path) -> None:
    trust = Trust(ca=str(certificates / "ca.pem"))
    with serving(server_context(certificates, "alice"), None) as endpoint:
        said = probe(endpoint, trust, LIMIT_S)
        assert said == ("the listener's certificate is for another name than 127.0.0.1: dial a name that is in it")
        lenient = Trust(ca=str(certificates / "ca.pem"), check_name=False)
        assert probe(endpoint, lenient, LIMIT_S) is None


def test_a_certificate_that_has_expired(certificates: Path, tmp_path: Path) -> None:
    authority = issue("authority", [], 1.0)
    save(tmp_path, "ca", authority)
    save(tmp_path, "world", issue("world", ["127.0.0.1"], -0.001, authority))
    with serving(server_context(tmp_path), None) as endpoint:
        said = probe(endpoint, Trust(ca=str(tmp_path / "ca.pem")), LIMIT_S)
    assert said == "the listener's certificate, or --tls-ca, has expired"


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_refusals_of_either_version_of_tls(certificates: Path, version: ssl.TLSVersion) -> None:
    def trust(name: str | None) -> Trust:
        pair = (None, None) if name is None else tuple(str(certificates / f"{name}{end}") for end in (".pem", ".key"))
        return Trust(str(certificates / "ca.pem"), *pair)

    with serving(server_context(certificates, version=version), None) as endpoint:
        assert probe(endpoint, trust("alice"), LIMIT_S) is None
        assert probe(endpoint, trust(None), LIMIT_S) == NO_CERTIFICATE
        assert probe(endpoint, trust("other/alice"), LIMIT_S) == OTHER_AUTHORITY


@pytest.mark.parametrize("say", [b"", b"HTTP/1.0 400 Bad Request\r\n\r\n"])
def test_what_does_not_speak_tls(certificates: Path, say: bytes) -> None:
    with serving(None, say) as endpoint:
        said = probe(endpoint, Trust(ca=str(certificates / "ca.pem")), LIMIT_S)
    assert "not use TLS" in said


def test_who_says_nothing_is_waited_for_a_bounded_time(certificates: Path) -> None:
    with serving(None, None) as endpoint:
        said = probe(endpoint, Trust(ca=str(certificates / "ca.pem")), 0.2)
    assert said.startswith("the listener does not answer the handshake")


def test_who_hangs_up_after_the_handshake(certificates: Path) -> None:
    with serving(server_context(certificates), b"") as endpoint:
        said = probe(endpoint, Trust(ca=str(certificates / "ca.pem")), LIMIT_S)
    assert said == "the listener hangs up after the handshake"


async def test_without_tls_a_listener_that_is_there_is_told_from_one_that_is_not() -> None:
    endpoint = free_address()
    assert await why(endpoint, Security()) == f"{endpoint}: no program listens there"
    with serving(None, None) as there:
        there = there.replace("tls/", "tcp/")
        said = await why(there, Security())
        assert said.endswith("it may require --user and a password, or not be Zenoh")
        said = await why(there, Security(user="alice", password="secret"))
        assert "user or password may be wrong" in said


async def test_no_such_host() -> None:
    said = await why("tcp/nosuch.invalid:1", Security())
    assert "no such host" in said


async def test_what_a_probe_cannot_tell_is_none(certificates: Path) -> None:
    assert await why(free_address("quic"), own(certificates, "alice")) is None
    assert await why(free_address("udp"), Security()) is None
