"""Checks of whether this machine is good enough for a servo and its messages: a function each, with advice.

A check that requests something (real-time scheduling, locked memory) does so in a separate thread or releases it, so
the process is not changed.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from hapnet.errors import HapnetError
from hapnet.realtime.servo import FIFO_PRIORITY, DeadlineGrid, set_timer_slack
from hapnet.records.histogram import Histogram
from hapnet.transport.security import ANYBODY, Security

OK, WARNING, MISSING, SKIPPED = "ok", "warning", "missing", "skipped"

REACH_S = 3.0
"""The longest time to wait for an endpoint's answer [s]."""

_LATE_US = 100.0  # if the median sleep is later than this, the timer slack is the default or worse
_TICKS = 300
_PERIOD_NS = 1_000_000
_IS_LINUX: bool = sys.platform == "linux"
_CLOCK_MONOTONIC = 1
_MCL_CURRENT_AND_FUTURE = 3
_CAP_IPC_LOCK = 14
_PROCESSORS = Path("/sys/devices/system/cpu")

_T = TypeVar("_T")


@dataclass(frozen=True)
class Check:
    """`state`: ok, warning (hapnet runs, but worse), missing (it does not run) or skipped; `advice`: a remedy."""

    name: str
    state: str
    value: str
    advice: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The check as `--json` writes it."""
        return asdict(self)


def examine(
    connect: Sequence[str] = (), security: Security = ANYBODY, session: str = "default", name: str = "device"
) -> Iterator[Check]:
    """Yield all checks in the order of the output, each as soon as it is done.

    session, name : those of the sides on the probed network.

    Raises InvalidParameter: an endpoint that Zenoh does not accept, or security that does not fit it.
    """
    _require_endpoints(connect, security)
    checks: tuple[Callable[[], Check], ...] = (
        python, libraries, system, processors, load, clock_resolution, timer_slack, sleep_lateness, timerfd,
        real_time_scheduling, real_time_share, locked_memory, frequency_scaling,
    )  # fmt: skip
    for check in checks:
        yield check()
    for endpoint in connect:
        if endpoint.startswith("tls/"):
            yield tls_handshake(endpoint, security)
        reachable = zenoh_reachable(endpoint, security)
        yield reachable
        if reachable.state == OK:
            yield network(endpoint, security, session, name)
    if not connect:
        yield Check("zenoh reachable", SKIPPED, "no endpoint given", "-e tcp/HOST:PORT tries one")


def python() -> Check:
    gil = getattr(sys, "_is_gil_enabled", lambda: True)()
    value = f"{platform.python_implementation()} {platform.python_version()}, GIL {'on' if gil else 'off'}"
    if platform.python_implementation() != "CPython":
        return Check("python", WARNING, value, "the servo's figures are for CPython")
    return Check("python", OK, f"{value}, threads switch every {sys.getswitchinterval() * 1e3:g} ms (a run sets 0.1)")


_NEEDED = ("numpy", "eclipse-zenoh", "msgpack", "msgspec", "cryptography")
_OF_REPORTS = ("mcap", "protobuf", "matplotlib")  # the extra `report`


def libraries() -> Check:
    found, absent = [], []
    for name in (*_NEEDED, *_OF_REPORTS):
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            absent.append(name)
    if absent:
        state = MISSING if set(absent) & set(_NEEDED) else WARNING  # a side runs without the extra
        return Check("libraries", state, ", ".join(found), f"pip install {' '.join(absent)}")
    return Check("libraries", OK, ", ".join(found))


def system() -> Check:
    kernel = f"{platform.system()} {platform.release()}"
    if not _IS_LINUX:
        return Check("system", WARNING, kernel, "use Linux: elsewhere there is no timer slack, timerfd or SCHED_FIFO")
    value = [kernel]
    value += [kind for kind in ("PREEMPT_RT", "PREEMPT_DYNAMIC") if kind in platform.version()]
    if " hypervisor" in _read("/proc/cpuinfo"):
        value.append("in a virtual machine")
        advice = "the host may take the processor away at any time: for a real device use the bare machine"
        return Check("system", WARNING, ", ".join(value), advice)
    return Check("system", OK, ", ".join(value))


def processors() -> Check:
    count = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else count
    value = f"{usable} of {count} usable"
    if usable < 2:
        return Check("processors", WARNING, value, "give this process two (taskset, the container's limit)")
    return Check("processors", OK, value)


def load() -> Check:
    if not hasattr(os, "getloadavg"):
        return Check("load", SKIPPED, "not known here")
    busy, count = os.getloadavg()[0], os.cpu_count() or 1
    value = f"{busy:.2f} on {count} processors (1 min)"
    if busy > 0.5 * count:
        return Check("load", WARNING, value, "end other work before measuring, or use --realtime")
    return Check("load", OK, value)


def clock_resolution() -> Check:
    clock = time.get_clock_info("monotonic")
    steps = []
    for _ in range(100):
        began = now = time.monotonic_ns()
        while now == began:
            now = time.monotonic_ns()
        steps.append(now - began)
    resolution = clock.resolution
    value = f"{clock.implementation}: {resolution * 1e9:g} ns, steps of {min(steps)} ns measured"
    source = _read("/sys/devices/system/clocksource/clocksource0/current_clocksource").strip()
    value += f", source {source}" if source else ""
    if min(steps) > 5000:
        advice = "reading it costs too much: another clock source, if there is one (clocksource=tsc)"
        return Check("clock resolution", WARNING, value, advice)
    return Check("clock resolution", OK, value)


def timer_slack() -> Check:
    if _in_thread(set_timer_slack):
        return Check("timer slack", OK, "1 ns is available")
    return Check("timer slack", WARNING, "cannot be set", "sleeps end some 50 us late: use Linux, outside a sandbox")


def sleep_lateness() -> Check:
    histogram = _in_thread(_sleep)
    p50, p99 = ((histogram.quantile(q) or 0) / 1e3 for q in (0.50, 0.99))
    value = f"p50 {p50:.0f} us, p99 {p99:.0f} us, longest {histogram.max / 1e3:.0f} us at 1 kHz"
    if p50 > _LATE_US or p99 > _PERIOD_NS / 1e3:
        return Check("sleep lateness", WARNING, value, "see the lines on load, scaling and scheduling; `hapnet bench`")
    return Check("sleep lateness", OK, value)


def timerfd() -> Check:
    libc = ctypes.CDLL(None, use_errno=True) if _IS_LINUX else None
    descriptor = libc.timerfd_create(_CLOCK_MONOTONIC, 0) if libc is not None else -1
    if descriptor < 0:
        return Check("timerfd", WARNING, "not available", "the link releases up to a millisecond late: use Linux")
    os.close(descriptor)
    return Check("timerfd", OK, "available")


def real_time_scheduling() -> Check:
    name = "SCHED_FIFO"
    if not _IS_LINUX:
        return Check(name, WARNING, f"not available on {sys.platform}", "use Linux for --realtime")
    refused = _in_thread(_ask_for_fifo)
    if refused is None:
        return Check(name, OK, f"priority {FIFO_PRIORITY} allowed (rtprio limit {_limit('RLIMIT_RTPRIO')}): --realtime")
    advice = (
        f"allow it: `{_who()} - rtprio {FIFO_PRIORITY}` in /etc/security/limits.conf, then log in again "
        f"(`ulimit -r` shows it); in a container --cap-add SYS_NICE"
    )
    return Check(name, WARNING, f"{refused} (rtprio limit {_limit('RLIMIT_RTPRIO')})", advice)


def real_time_share() -> Check:
    name = "real-time share"
    runtime, period = (_read(f"/proc/sys/kernel/sched_rt_{what}_us").strip() for what in ("runtime", "period"))
    if not runtime or not period:
        return Check(name, SKIPPED, "not known here")
    if int(runtime) == 0:
        return Check(name, WARNING, "0", "sudo sysctl kernel.sched_rt_runtime_us=950000, or SCHED_FIFO never runs")
    share = "all of the time" if int(runtime) < 0 else f"{100 * int(runtime) / int(period):g} % of the time"
    return Check(name, OK, f"{share} (sched_rt_runtime_us {runtime})")


def locked_memory() -> Check:
    """Check whether the servo may lock all its memory, future memory too, which a limit may refuse now or later."""
    name = "locked memory"
    if not _IS_LINUX:
        return Check(name, WARNING, f"not available on {sys.platform}", "use Linux for --realtime")
    libc = ctypes.CDLL(None, use_errno=True)
    limit = _limit("RLIMIT_MEMLOCK")
    capable = _capable(_CAP_IPC_LOCK)
    if limit != "unlimited" and not capable:
        value = f"limited to {limit} bytes, too few for all of a process"
    elif libc.mlockall(_MCL_CURRENT_AND_FUTURE) == 0:
        libc.munlockall()
        return Check(name, OK, f"allowed ({'CAP_IPC_LOCK' if capable else 'no memlock limit'})")
    else:
        value = f"{os.strerror(ctypes.get_errno())} (memlock limit {limit})"
    advice = (
        f"allow it: `{_who()} - memlock unlimited` in /etc/security/limits.conf, then log in again (`ulimit -l` shows "
        f"it); in a container --cap-add IPC_LOCK"
    )
    return Check(name, WARNING, value, advice)


def frequency_scaling() -> Check:
    name = "frequency scaling"
    files = sorted(_PROCESSORS.glob("cpu*/cpufreq/scaling_governor"))
    governors = sorted({_read(str(file)).strip() for file in files} - {""})
    if not governors:
        return Check(name, OK, "not controlled by this system (virtual machine, firmware, or none)")
    if governors == ["performance"]:
        return Check(name, OK, f"governor performance on all {len(files)} processors")
    advice = "sudo cpupower frequency-set -g performance (or write it to each cpu*/cpufreq/scaling_governor)"
    return Check(name, WARNING, f"governor {', '.join(governors)}", advice)


def tls_handshake(endpoint: str, security: Security = ANYBODY) -> Check:
    """Check the TLS handshake with a device's certificates, as Zenoh does not report their faults."""
    from hapnet.transport.config import ZenohSettings, zenoh_config
    from hapnet.transport.diagnosis import Trust, probe

    trust = Trust.of(zenoh_config(ZenohSettings(connect=(endpoint,), security=security)))
    refused = probe(endpoint, trust, REACH_S)
    if refused is not None:
        return Check("tls handshake", MISSING, f"{endpoint}: {refused}")
    return Check("tls handshake", OK, f"{endpoint} and this side accept each other's certificates")


def zenoh_reachable(endpoint: str, security: Security = ANYBODY) -> Check:
    """Connect as a device does, for at most `REACH_S` seconds."""
    name = "zenoh reachable"
    advice = "start the other side (hapnet world -l ...), and check address, port and firewall"
    try:
        took = asyncio.run(_dial(endpoint, security))
    except HapnetError as error:
        return Check(name, MISSING, f"{endpoint}: {' '.join(str(error).split())}", advice)
    if took is not None:
        return Check(name, OK, f"{endpoint} answered within {took * 1e3:.0f} ms")
    return Check(name, MISSING, f"{endpoint} did not answer within {REACH_S:g} s", advice)


def network(endpoint: str, security: Security, session: str, name: str) -> Check:
    """Check whether the path to that endpoint is good enough."""
    from hapnet.ext.doctor.network import probed

    return probed(endpoint, security, session, name)


# Zenoh is imported where it is needed, so that a check can report that it is missing.


def _require_endpoints(connect: Sequence[str], security: Security) -> None:
    security.check()
    if connect:
        from hapnet.transport.config import ZenohSettings, zenoh_config

        for endpoint in connect:
            zenoh_config(ZenohSettings(connect=(endpoint,), security=security))


async def _dial(endpoint: str, security: Security) -> float | None:
    from hapnet.transport.config import ZenohSettings
    from hapnet.transport.zenoh import ZenohTransport

    settings = ZenohSettings(connect=(endpoint,), security=security)
    transport = ZenohTransport(settings, lambda kind, data, now_ns: None, session=f"doctor-{os.getpid()}")
    began = time.monotonic()
    await transport.open()
    try:
        while (elapsed := time.monotonic() - began) < REACH_S:
            if transport.peers:
                return elapsed
            await asyncio.sleep(0.01)
        return None
    finally:
        await transport.close()


def _sleep() -> Histogram:
    """Measure the lateness of sleeps to absolute deadlines [ns]."""
    set_timer_slack()
    histogram = Histogram()
    grid = DeadlineGrid(time.monotonic_ns() + _PERIOD_NS, _PERIOD_NS)
    for _ in range(_TICKS):
        while (left_ns := grid.deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns * 1e-9)
        histogram.add(-left_ns)
        grid.advance(time.monotonic_ns())
    return histogram


def _ask_for_fifo() -> str | None:
    """Request SCHED_FIFO for this thread only, which ends afterwards. Returns the reason if it was refused."""
    refused = None
    if sys.platform == "linux":
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
        except OSError as error:
            refused = error.strerror or str(error)
    return refused


def _in_thread(call: Callable[[], _T]) -> _T:
    """Return the result of `call` in a separate thread, so that its requests end with that thread."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(call).result()


def _limit(name: str) -> str:
    limit = "unlimited"
    if sys.platform == "linux":
        import resource

        if (soft := resource.getrlimit(getattr(resource, name))[0]) != resource.RLIM_INFINITY:
            limit = str(soft)
    return limit


def _capable(capability: int) -> bool:
    """Whether this process has the capability with this number."""
    for line in _read("/proc/self/status").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> capability & 1)
    return False


def _who() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "<user>"


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
