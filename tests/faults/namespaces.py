"""Two hosts and a cable: two network namespaces of Linux, joined by a pair of virtual Ethernet devices.

They are made inside a user namespace of their own, so no rights are needed where the kernel lets anybody have one, and
nothing of the machine's own network is touched, not even a name. A holder process keeps each namespace; it ends with
the pipe that it reads from, so that nothing stays behind even if the tests are killed.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from tests.conftest import ENVIRONMENT
from tests.faults.tun import CABLE

LIMIT_S = 60.0
"""How long anything may take before a test gives up on it."""

_TOOLS = ("ip", "unshare", "nsenter", "cat")


class Unavailable(Exception):
    """This machine cannot do it, and why: a tool or a permission is missing."""


class Host:
    """A network namespace with an address of each kind on its end of the cable.

    enter : put before a command, it runs there, as the process that was started.
    """

    def __init__(self, holder: int, number: int) -> None:
        self.enter = ["nsenter", "-t", str(holder), "-U", "-n", "--preserve-credentials"]
        self.address, self.address6 = f"10.117.0.{number}", f"fd00:117::{number}"

    def run(self, *command: str) -> str:
        """The output of a command that is run here; raises CalledProcessError if it fails."""
        all_words = [*self.enter, *command]
        return subprocess.run(all_words, check=True, capture_output=True, text=True, timeout=LIMIT_S).stdout

    def ip(self, words: str) -> str:
        return self.run("ip", *words.split())

    def configure(self) -> None:
        """The addresses, and both interfaces up."""
        self.ip(f"address add {self.address}/24 dev {CABLE}")
        self.ip("link set lo up")
        self.plug()

    def pull(self) -> None:
        """Take the cable out of this host; the other one sees that it has no carrier."""
        self.ip(f"link set {CABLE} down")

    def plug(self) -> int:
        """Put it back; when that was begun [ns]. IPv6 addresses leave with their interface and are given anew."""
        began_ns = time.monotonic_ns()
        self.ip(f"link set {CABLE} up")
        self.ip(f"address replace {self.address6}/64 dev {CABLE} nodad")
        return began_ns


@contextlib.contextmanager
def two_hosts(words: str | None = None, seed: int = 0) -> Iterator[tuple[Host, Host]]:
    """Two hosts and the cable between them; gone at the end, whatever happens.

    words : the cable is a link of the emulator's, with that profile, packet by packet; None: a perfect one.

    Raises Unavailable: they cannot be made here.
    """
    missing = [tool for tool in _TOOLS if shutil.which(tool) is None]
    if missing:
        raise Unavailable(f"no such tool: {', '.join(missing)}")
    with contextlib.ExitStack() as stack:
        try:
            first = stack.enter_context(_held(["unshare", "--user", "--map-root-user", "--net"]))
            a = Host(first, 1)
            second = stack.enter_context(_held([*a.enter, "unshare", "--net"]))
            b = Host(second, 2)
            if words is None:
                a.ip(f"link add {CABLE} type veth peer name {CABLE} netns {second}")
            else:
                stack.enter_context(_emulated(first, second, words, seed))
            a.configure()
            b.configure()
        except subprocess.CalledProcessError as error:
            raise Unavailable(f"network namespaces: {_said(error)}") from None
        yield a, b


@contextlib.contextmanager
def _held(command: list[str]) -> Iterator[int]:
    """A process in the network namespace that `command` makes, which keeps it; its id."""
    holder = subprocess.Popen(
        [*command, "cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        start_new_session=True,
    )  # fmt: skip
    assert holder.stdin is not None
    assert holder.stderr is not None
    try:
        deadline = time.monotonic() + LIMIT_S
        while _name(holder.pid) != "cat":  # before, it is the namespace's maker
            if holder.poll() is not None:
                raise subprocess.CalledProcessError(holder.returncode, command, "", holder.stderr.read().decode())
            assert time.monotonic() < deadline, f"not in time: {' '.join(command)}"
            time.sleep(0.002)
        yield holder.pid
    finally:
        holder.stdin.close()
        holder.stderr.close()
        holder.kill()
        holder.wait(LIMIT_S)


@contextlib.contextmanager
def _emulated(first: int, second: int, words: str, seed: int) -> Iterator[None]:
    """The emulator between the namespaces of two processes."""
    if os.geteuid() != 0:
        raise Unavailable("TUN devices in other namespaces: only for root")
    command = [sys.executable, "-m", "tests.faults.tun", str(first), str(second), words, str(seed)]
    joint = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
    )
    assert joint.stdin is not None
    assert joint.stdout is not None
    assert joint.stderr is not None
    try:
        if joint.stdout.readline() != "ready\n":
            said = joint.stderr.read().strip().splitlines()
            raise Unavailable(f"TUN devices: {said[-1] if said else 'no reason was given'}")
        yield
    finally:
        joint.stdin.close()
        joint.wait(LIMIT_S)
        joint.stdout.close()
        joint.stderr.close()


def _name(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/comm").read_text("ascii").strip()
    return ""


def _said(error: subprocess.CalledProcessError) -> str:
    words = " ".join(str(error.stderr).split())
    return words or f"{error.cmd[0]} ended with exit code {error.returncode}"
