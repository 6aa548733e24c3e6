"""How late the emulated link releases, beside a bare timerfd on an asyncio loop (netem's own benchmark)."""

from __future__ import annotations

from hapnet.ext.bench.row import Distribution, Options, Row
from netem.bench import LATENESS_PROFILE, RATE, lateness_runs


def link_release(options: Options) -> Row:
    """Time from a packet's due time to its release, 2,000 packets a second."""
    runs = lateness_runs(options.rounds, options.seconds)
    subject, bare = ([Distribution.of(run[i], 1e-3) for run in runs] for i in (0, 1))
    what = f"release lateness of a link with {LATENESS_PROFILE.split(' limit')[0]}, {RATE} a second"
    return Row("link_release", "us", what, subject, "bare timerfd on an asyncio loop", bare)
