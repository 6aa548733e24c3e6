"""Report which nodes were refused, and why, from Zenoh's own log, which Zenoh writes to standard output.

So file descriptor 1 is redirected to a pipe that is read here, and Python's `sys.stdout` to the former target. The pipe
never blocks Zenoh's threads: lines that do not fit are lost. If RUST_LOG is set, Zenoh's log is printed unchanged.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import threading
from collections.abc import Iterator

import zenoh

from hapnet.transport.config import ZenohSettings, endpoints_of, zenoh_config
from hapnet.transport.security import ENCRYPTED

AGAIN_NS = 10_000_000_000
"""The same refusal is reported once in this time [ns]."""

MOST_REPORTED = 20
"""The most different refusals that are kept, so that a stranger cannot fill a log."""

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_OWN = re.compile(r"\S+Z +(?:TRACE|DEBUG|INFO|WARN|ERROR) ")
_CERTIFICATE = re.compile(r"zenoh_link_\w+\S* (?:.*?)?(invalid peer certificate: \w+|peer sent no certificates)")
_ALERT = re.compile(r"zenoh_link_\w+\S* .*?received fatal alert: (\w+)")
_NAMED = re.compile(r" (?P<node>\w+) on \S*(?:CertCommonName|Username)\((?P<who>[^)]*)\)")
_DENIED = re.compile(  # a put counts only as a cached result: otherwise Zenoh works it out in advance for each key
    r"(?: (?P<node>\w+) on \S+ is unauthorized to (?P<what>Declare Subscriber|Liveliness Token)"
    r"|Using cached result: (?P<cached>\w+) is unauthorized to (?P<which>Put|Declare Subscriber|Liveliness Token))"
    r" \(ingress\) on (?P<key>\S+)/"
)
_IS_POSIX: bool = sys.platform != "win32"
"""Windows has no pipe that never blocks its writers: refusals are not reported there."""
_MOST_NAMES = 256
_PIPE_BYTES = 2**20


class RefusalReader:
    """Finds refusals in lines of Zenoh's log."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}  # by node

    def refusal(self, line: str) -> str | None:
        """The refusal that a line reports, as text; None: it reports none."""
        text = _COLOURS.sub("", line)
        if found := _CERTIFICATE.search(text):
            return f"refused a side that dials: {found[1]}"
        if found := _ALERT.search(text):
            return f"a side that dials refuses this side's certificate, or shows none that fits ({found[1]})"
        if (named := _NAMED.search(text)) and len(self._names) < _MOST_NAMES:
            self._names[named["node"]] = named["who"]
        if found := _DENIED.search(text):
            node, what = found["node"] or found["cached"], found["what"] or found["which"]
            verb = "read" if what == "Declare Subscriber" else "write to"
            return f"access control does not let {self._names.get(node, node)} {verb} {found['key']}/..."
        return None


class Refusals:
    """Refusals that were not reported yet; one thread reads the lines, another takes the refusals."""

    def __init__(self) -> None:
        self._log = RefusalReader()
        self._new: dict[str, None] = {}
        self._reported_ns: dict[str, int] = {}

    def read(self, line: str) -> bool:
        """Read a line of output; False if it is not from Zenoh's log."""
        if (text := self._log.refusal(line)) is not None and len(self._new) < MOST_REPORTED:
            self._new[text] = None
        return _OWN.match(_COLOURS.sub("", line)) is not None

    def take(self, now_ns: int) -> list[str]:
        """The refusals to report now."""
        new, self._new = self._new, {}
        self._reported_ns = {text: at_ns for text, at_ns in self._reported_ns.items() if now_ns - at_ns < AGAIN_NS}
        due = [text for text in new if text not in self._reported_ns][: MOST_REPORTED - len(self._reported_ns)]
        self._reported_ns.update(dict.fromkeys(due, now_ns))
        return due


@contextlib.contextmanager
def watched(settings: ZenohSettings) -> Iterator[Refusals]:
    """Read Zenoh's log inside this context, if nodes that dial this side may be refused.

    Access control logs a line for each message, allowed or denied, which costs some microseconds a message.
    """
    refusals = Refusals()
    config = zenoh_config(settings)
    encrypted = any(endpoint.partition("/")[0] in ENCRYPTED for endpoint in endpoints_of(config, "listen"))
    controlled = json.loads(config.get_json("access_control")).get("enabled") is True
    if "RUST_LOG" in os.environ or not _IS_POSIX or not (encrypted or controlled):
        yield refusals
        return
    directives = "off" + ",zenoh_link_tls=warn,zenoh_link_quic=warn" * encrypted
    directives += ",zenoh::net::routing::interceptor::access_control=trace" * controlled
    sys.stdout.flush()
    before, (source, sink) = os.dup(1), os.pipe()
    if sys.platform != "win32":
        os.set_blocking(sink, False)
    if sys.platform == "linux":  # room while the reader is delayed
        import fcntl

        with contextlib.suppress(OSError):
            fcntl.fcntl(sink, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    os.dup2(sink, 1)
    os.close(sink)
    stdout, sys.stdout = sys.stdout, os.fdopen(os.dup(before), "w", encoding="utf-8", errors="backslashreplace")
    if os.isatty(before):
        sys.stdout.reconfigure(line_buffering=True)
    reader = threading.Thread(target=_read, args=(source, before, refusals), name="zenoh-log", daemon=True)
    reader.start()
    try:
        zenoh.init_log_from_env_or(directives)
        yield refusals
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.close()
        sys.stdout = stdout
        os.dup2(before, 1)  # this closes the last writer of the pipe, so the reader ends
        reader.join(1.0)


def _read(source: int, out: int, refusals: Refusals) -> None:
    with os.fdopen(source, "rb") as lines:
        for line in lines:
            if not refusals.read(line.decode(errors="replace")):
                with contextlib.suppress(OSError):
                    os.write(out, line)
