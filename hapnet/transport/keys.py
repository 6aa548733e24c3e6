"""Which keys are to be kept alive, and which are dead, so that the transport mends them; the time is an argument.

A declaration of a subscriber is said once. Over udp it may be lost, or dropped as it is overtaken by a later one, and
then nothing ever arrives on its key. So each key carries something at least every `KEEP_ALIVE_NS`, and a side that
hears nothing on one of them declares again. A declaration is one datagram if its key expression begins with a wildcard;
another one would need two, in order, and is known to Zenoh already if it was lost, which then does not repeat it.
"""

from __future__ import annotations

from collections.abc import Iterable

KEEP_ALIVE_NS = 200_000_000
"""Each key carries something at least so often."""

WATCH_NS = 50_000_000
"""How often it is looked at; a keep-alive leaves when the key was quiet for so much less."""

SILENT_NS = 450_000_000
"""A key is silent when nothing came for longer: two keep-alives, and what a network may delay the second."""

AGAIN_NS = 250_000_000
"""How long a declaration may take to have an effect before the next one."""

DEAD_NS = 10_000_000_000
"""A key that is silent for longer cannot be mended by declarations: what its publisher declared is lost."""

LONGEST_DEAD_NS = 80_000_000_000
"""Another session is opened no more seldom than so, while somebody is connected and nothing is heard at all."""

_FIRST = ("*", "hapnet", "h$*", "ha$*", "hap$*", "hapn$*", "hapne$*")
"""The first chunk of declaration after declaration. The literal one is for access control, which takes no wider one."""

_LAST = "$*n$*"
"""Any of position, energy, control; not telemetry, which is not for the peer."""


class KeyWatch:
    """The keys of one side's connection. Any thread may say `sent` and `heard`; one asks for the rest.

    kinds : the last parts of the keys.
    """

    def __init__(self, kinds: Iterable[str]) -> None:
        self._sent_ns = dict.fromkeys(kinds, 0)
        self._heard_ns = dict.fromkeys(self._sent_ns, 0)
        self._since_ns: int | None = None  # connected from then on
        self._again_ns = 0
        self._patience_ns = DEAD_NS

    def sent(self, kind: str, now_ns: int) -> None:
        """Something was put on the key."""
        self._sent_ns[kind] = now_ns

    def heard(self, kind: str, now_ns: int) -> None:
        """Something came on the key."""
        self._heard_ns[kind] = now_ns
        self._patience_ns = DEAD_NS

    def quiet(self, now_ns: int) -> list[str]:
        """The keys that a keep-alive is due on."""
        latest_ns = now_ns - KEEP_ALIVE_NS + WATCH_NS
        return [kind for kind, sent_ns in self._sent_ns.items() if sent_ns <= latest_ns]

    def connected(self, now_ns: int, *, is_connected: bool) -> None:
        """Whether there is anybody to hear; who has just come is given `SILENT_NS` to speak."""
        if not is_connected:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns

    def silent(self, now_ns: int, for_ns: int = SILENT_NS) -> list[str]:
        """The keys on which nothing came for so long, though somebody is connected."""
        if self._since_ns is None or now_ns - self._since_ns <= for_ns:
            return []
        return [kind for kind, heard_ns in self._heard_ns.items() if now_ns - heard_ns > for_ns]

    def declare_now(self, now_ns: int) -> bool:
        """Is it time to declare again? Asked and answered once for each declaration."""
        if now_ns < self._again_ns or not self.silent(now_ns):
            return False
        self._again_ns = now_ns + AGAIN_NS
        return True

    def dead(self, now_ns: int) -> list[str]:
        """The keys that are dead, as no declaration helps; asked once for each session that is opened for it.

        If all are silent it may be that somebody else is connected. So it counts only if the other side was heard
        before, and each time less often.
        """
        silent = self.silent(now_ns, DEAD_NS)
        if len(silent) < len(self._heard_ns):
            return silent
        if not any(self._heard_ns.values()) or len(self.silent(now_ns, self._patience_ns)) < len(silent):
            return []
        self._patience_ns = min(2 * self._patience_ns, LONGEST_DEAD_NS)
        return silent


def key_expressions(prefix: str) -> list[str]:
    """Different key expressions of the three keys below ``hapnet/...``, to be declared one after another."""
    rest = prefix.partition("/")[2]
    return [f"{first}/{rest}/{_LAST}" for first in _FIRST]
