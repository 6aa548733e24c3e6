"""Find the keys that need a keep-alive or are dead, so that the transport repairs them; the time is an argument.

Zenoh sends a subscriber's declaration once. Over udp it may be lost, or dropped because a later one overtook it; then
no message ever arrives on its key. So each key carries a message at least every `KEEP_ALIVE_NS`, and a side declares
again if a key is silent. A declaration is one datagram if its key expression begins with a wildcard. Any other needs
two, in order: the first assigns a number to its literal beginning. Zenoh does not repeat the first, even if it was
lost; it then sends all messages whose keys begin so under this number, which the receiver cannot resolve. So over
such a link a side declares no literal beginning of the keys on which it publishes (`any_node`).
"""

from __future__ import annotations

from collections.abc import Iterable

KEEP_ALIVE_NS = 200_000_000
"""Each key carries a message at least this often [ns]."""

WATCH_NS = 50_000_000
"""The period of the checks of the keys [ns]; a keep-alive is sent up to this much before `KEEP_ALIVE_NS` is over."""

SILENT_NS = 450_000_000
"""A key is silent if no message came for longer [ns]: two keep-alives, and some delay of the second."""

AGAIN_NS = 250_000_000
"""The time in which a declaration must have an effect before the next one is sent [ns]."""

IN_VAIN = 10
"""A key is dead if it is silent after more declarations: the publisher's was lost, which this side cannot repair."""

MOST_IN_VAIN = 320
"""The most declarations before another session is opened, if earlier ones did not help: one every 80 s."""

_FIRST = ("*", "hapnet", "h$*", "ha$*", "hap$*", "hapn$*", "hapne$*")
"""The first chunks of successive declarations. The literal one is for access control, which allows no wider one."""

_LAST = "$*n$*"
"""Matches position, energy and control, but not telemetry, which is not for the peer."""


class KeyWatch:
    """Monitors the keys of one side's connection. Any thread may call `sent` and `heard`; one thread calls the rest.

    kinds : the last parts of the keys.
    """

    def __init__(self, kinds: Iterable[str]) -> None:
        self._sent_ns = dict.fromkeys(kinds, 0)
        self._heard_ns = dict.fromkeys(self._sent_ns, 0)
        self._since_ns: int | None = None  # connected from then on
        self._again_ns = 0
        self._in_vain = dict.fromkeys(self._sent_ns, 0)  # declarations since a message came on the key
        self._patience = dict.fromkeys(self._sent_ns, IN_VAIN)

    def sent(self, kind: str, now_ns: int) -> None:
        """Enter a message that was put on the key."""
        self._sent_ns[kind] = now_ns

    def heard(self, kind: str, now_ns: int) -> None:
        """Enter a message that came on the key; other keys are ignored."""
        if kind not in self._heard_ns:
            return
        self._heard_ns[kind] = now_ns
        self._in_vain[kind] = 0
        self._patience[kind] = IN_VAIN

    def quiet(self, now_ns: int) -> list[str]:
        """The keys on which a keep-alive is due."""
        latest_ns = now_ns - KEEP_ALIVE_NS + WATCH_NS
        return [kind for kind, sent_ns in self._sent_ns.items() if sent_ns <= latest_ns]

    def connected(self, now_ns: int, *, is_connected: bool) -> None:
        """Enter whether any node is connected; a new node has `SILENT_NS` to send a message."""
        if not is_connected:
            self._since_ns = None
            self._in_vain = dict.fromkeys(self._in_vain, 0)
        elif self._since_ns is None:
            self._since_ns = now_ns

    def silent(self, now_ns: int, for_ns: int = SILENT_NS) -> list[str]:
        """The keys on which no message came for `for_ns`, although a node is connected."""
        if self._since_ns is None or now_ns - self._since_ns <= for_ns:
            return []
        return [kind for kind, heard_ns in self._heard_ns.items() if now_ns - heard_ns > for_ns]

    def declare_now(self, now_ns: int) -> bool:
        """Whether it is time to declare again. Each True stands for one declaration."""
        if now_ns < self._again_ns or not (silent := self.silent(now_ns)):
            return False
        self._again_ns = now_ns + AGAIN_NS
        for kind in silent:
            self._in_vain[kind] += 1
        return True

    def dead(self, now_ns: int) -> list[str]:
        """The keys that are dead: no declaration helps. The caller then opens another session.

        If all keys are silent, the connected node may not be the other side. So they count as dead only if a message
        of the other side came before. A key that stays silent afterwards gets twice as many declarations each time.
        """
        silent = self.silent(now_ns)
        dead = [kind for kind in silent if self._in_vain[kind] > self._patience[kind]]
        if len(silent) == len(self._heard_ns) and (len(dead) < len(silent) or not any(self._heard_ns.values())):
            return []
        for kind in dead:
            self._patience[kind] = min(2 * self._patience[kind], MOST_IN_VAIN)
        return dead


def key_expressions(prefix: str) -> list[str]:
    """Different key expressions for the three keys below ``hapnet/...``, to be declared one after another."""
    rest = prefix.partition("/")[2]
    return [f"{first}/{rest}/{_LAST}" for first in _FIRST]


def any_node(prefix: str, *, lossy: bool) -> str:
    """Return the key that matches the tokens of all nodes that publish below ``hapnet/...``; over a lossy link without
    a literal beginning, although access control allows only a key with one.
    """
    return f"*/{prefix.partition('/')[2]}/*" if lossy else f"{prefix}/*"
