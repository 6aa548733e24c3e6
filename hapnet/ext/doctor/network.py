"""Compare a network with the requirements of haptics, by probes."""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.errors import TransportError
from hapnet.ext.doctor.machine import OK, REACH_S, WARNING, Check
from hapnet.transport.config import ZenohSettings, zenoh_config
from hapnet.transport.probe import PROBE, Answers, ask
from hapnet.transport.security import Security

PROBED_S = 4.0
"""The time of the measurement [s]."""

FAST_MS, SLOW_MS = 20.0, 100.0
"""One-way delay in 3GPP TR 22.847 (tactile and multi-modal communication): 20 ms for fast motion, 100 ms for slow."""
RELIABILITY = 0.9999
"""The required share of messages that arrive (same source)."""
BAD_LOSS = 0.05

NAME = "network"


def probed(
    endpoint: str, security: Security, session: str, name: str, seconds: float = PROBED_S, patience_s: float = REACH_S
) -> Check:
    """Probe the path to the side that listens at `endpoint` under these names. Raises as `zenoh_config` does."""
    up, down = (f"hapnet/{session}/{name}/{direction}/{PROBE}" for direction in ("up", "down"))
    config = zenoh_config(ZenohSettings(connect=(endpoint,), security=security))
    answers = None
    for asked, answered in ((up, down), (down, up), (up, down)):  # over udp a declaration may be lost: probe once more
        try:
            answers = ask(config, asked, answered, seconds, patience_s)
        except TransportError as error:
            return Check(NAME, WARNING, f"{endpoint}: {error}", "see the line on Zenoh")
        if answers is not None:
            break
    else:
        advice = (
            f"start the other side there (hapnet world -l ...), with the session {session} and the name {name}; a side "
            "of an older version does not answer, nor does a side whose access control refuses this one"
        )
        return Check(NAME, WARNING, f"{endpoint}: no answer to probes, so its quality is not known", advice)
    return judged(answers)


def judged(answers: Answers) -> Check:
    """Return the check with the measurements, and the tasks for which they suffice."""
    p50, p99 = (1e-6 * (answers.trips.quantile(q) or 0) for q in (0.5, 0.99))
    there, back = answers.losses
    one_way, worst = p99 / 2, max(there, back)
    words = [
        f"round trip {p50:.1f} ms (99 %: {p99:.1f})",
        f"jitter {p99 - 1e-6 * (answers.min_ns or 0):.1f} ms",
        f"lost {100 * there:.2f} % there, {100 * back:.2f} % back",
    ]
    if answers.stalls:
        words.append(f"{answers.stalls} stalls, up to {answers.max_stall_ns * 1e-6:.0f} ms")
    if one_way <= FAST_MS:
        words.append(f"good for fast motion ({FAST_MS:g} ms one way, TR 22.847)")
    elif one_way <= SLOW_MS:
        words.append(f"good for slow motion ({SLOW_MS:g} ms one way, TR 22.847)")
    else:
        words.append(f"slower than TR 22.847 requires ({SLOW_MS:g} ms one way)")
    advice = _advice(answers, one_way, worst)
    return Check(NAME, WARNING if advice else OK, ", ".join(words), "; ".join(advice))


def _advice(answers: Answers, one_way: float, worst: float) -> Sequence[str]:
    advice = []
    if one_way > SLOW_MS:
        advice.append(
            "it stays passive, but contacts are felt late, and soft ones hardly: use a nearer world, or move slower"
        )
    if worst > BAD_LOSS:
        advice.append("it stays passive, but the proxy jumps: use a cable, another channel, or less other traffic")
    elif worst > 1.0 - RELIABILITY:
        advice.append(f"TR 22.847 requires {100 * RELIABILITY:g} % of the messages; less makes contacts less clear")
    if answers.stalls:
        advice.append("tcp turns loss into stalls, and a sleeping radio makes some: try udp/ or quic/ on both sides")
    return advice
