"""Who was refused, out of Zenoh's log: its lines here are what it wrote (1.10.2)."""

from pathlib import Path

import pytest

from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.refusals import AGAIN_NS, MOST_REPORTED, RefusalReader, Refusals
from tests.support.processes import started
from tests.support.transports import Side, opened, own

STAMP = "\x1b[2m2026-11-22T01:29:21.241088Z\x1b[0m \x1b[33m WARN\x1b[0m acc-0 ThreadId(07) "
TLS = STAMP + "\x1b[2mzenoh_link_tls::unicast\x1b[0m\x1b[2m:\x1b[0m "
ACCESS = "2026-11-22T01:29:21Z TRACE zenoh::net::routing::interceptor::access_control: "
SUBJECT = "2423a on Interface(lo)+CertCommonName(bob)+Transport(Tls)+2423a"
HINT = " Hint: increase the system open file limit."


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (
            [TLS + "invalid peer certificate: BadSignature." + HINT],
            "refused a side that dials: invalid peer certificate: BadSig",
        ),
        ([TLS + "received fatal alert: DecryptError." + HINT], "a side that dials refuses this side's certificate"),
        (
            [ACCESS + f"{SUBJECT} is unauthorized to Declare Subscriber (ingress) on hapnet/s/alice/down/energy"],
            "access control does not let bob read hapnet/s/alice/down/...",
        ),
        (
            [
                ACCESS + f"{SUBJECT} is unauthorized to Delete (ingress) on hapnet/s/alice/up/energy",
                ACCESS + "Using cached result: 2423a is unauthorized to Put (ingress) on hapnet/s/alice/up/energy",
            ],
            "access control does not let bob write to hapnet/s/alice/up/...",
        ),
        ([ACCESS + f"{SUBJECT} is unauthorized to Put (ingress) on hapnet/s/alice/up/energy"], None),
        ([ACCESS + "Using cached result: 2423a is authorized to Put (ingress) on hapnet/s/alice/up/energy"], None),
        ([TLS + "No new connections."], None),
    ],
)
def test_what_a_line_says_of_who_was_refused(lines: list[str], says: str | None) -> None:
    log = RefusalReader()
    last = [log.refusal(line) for line in lines][-1]
    assert last is None if says is None else last is not None and last.startswith(says)


def test_each_is_told_once_in_a_while_and_not_too_many() -> None:
    refusals, line = Refusals(), TLS + "invalid peer certificate: UnknownIssuer."
    assert refusals.read(line)
    assert len(refusals.take(0)) == 1
    refusals.read(line)
    assert refusals.take(AGAIN_NS - 1) == []
    refusals.read(line)
    assert len(refusals.take(AGAIN_NS)) == 1
    for number in range(3 * MOST_REPORTED):
        refusals.read(ACCESS + f"Using cached result: {number} is unauthorized to Put (ingress) on a/b/c")
    reported = refusals.take(AGAIN_NS + 1)
    assert 0 < len(reported) < MOST_REPORTED
    assert not refusals.read("what the program itself prints\n")


async def test_a_world_says_whom_it_does_not_let_in(certificates: Path) -> None:
    address = free_address("tls")
    files = ("--tls-ca", certificates / "ca.pem", "--tls-cert", certificates / "world.pem")
    access = ("-c", Path(__file__).resolve().parents[2] / "examples" / "secure" / "access.json5")
    flags = (*files, "--tls-key", certificates / "world.key", "--mutual-tls", *access, "--name", "alice")
    with started("world", "-l", address, *flags) as world:
        for name, ca, says in (
            ("bob", ".", "access control does not let bob"),
            ("other/alice", "other", "a side that dials refuses this side's certificate"),
            ("other/alice", ".", "refused a side that dials: invalid peer certificate"),
        ):
            security = own(certificates, name, ca=ca)
            side = Side("device", ZenohSettings(connect=(address,), security=security), device="alice")
            async with opened(side):
                world.until_line(says)
