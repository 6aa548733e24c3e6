"""What the tests share: where the recorded inputs are, processes' environment, certificates, random matrices."""

import gc
import os
import signal
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from hapnet.checks import Array
from hapnet.ext.compiled import background, catalogue, real_time, sources
from hapnet.records.machine_code import no_compiler

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))}
"""For processes that a test starts, in a directory of its own perhaps: they run this tree's hapnet."""

settings.register_profile("hapnet", deadline=None)  # how long an example takes depends on what else runs here
settings.load_profile("hapnet")
WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
"""Which of the processes this is that run tests."""

_SIGNALS = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)
_REAL_TIME = ("hapnet.ext.bench", "hapnet.realtime", "hapnet.transport", "netem.aio", "netem.bench", "netem.relay",
              "netem.zenoh_relay", "tests.faults", "tests.support.processes", "tests.view")  # fmt: skip
_PROCESSES = ("multiprocessing", "subprocess", "tests.support.processes", "hapnet.processes")
_WHOLE_RUNS = ("examples", "hapnet.cli", "hapnet.commands", "hapnet.ext.compiled.real_time", "hapnet.simulation",
               "hapnet.ext.study", "netem.cli", "tests.support.notebooks")  # fmt: skip
_VIRTUAL_TIME = ("tests.assembly", "tests.commands.test_bad_input", "tests.commands.test_typed_flags",
                 "tests.commands.test_verdict_of_recordings", "tests.repository.test_examples",
                 "tests.control.test_contact_effects", "tests.couplings", "tests.plant.worlds.test_picture",
                 "tests.properties.test_endurance", "tests.simulation.test_arms", "tests.simulation.test_processes",
                 "tests.study", "tests.summary.test_margins", "tests.view.test_each_call")  # fmt: skip


def pytest_configure() -> None:
    """A shell starts its background jobs with Ctrl-C ignored, and children inherit that; some tests press it.

    Three workers share the processors: linear algebra takes one thread in each, or they wait for one another.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def remembered(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What hapnet remembers of devices is not the user's own file."""
    os.environ["XDG_STATE_HOME"] = ENVIRONMENT["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.hookimpl(tryfirst=True)  # before those who read marks and groups then
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that run in real time are one worker's, one after the other; all others are the other workers'.

    One that fails is run once more, and both are reported: a shared machine may stand still for longer than it allows.
    The second time is a little later, as what holds a machine up seldom lasts for a moment only. So are tests that
    start processes. A test that hangs has failed after some minutes, except one that is to run for hours.

    What neither runs in real time, nor starts processes, nor makes whole runs, nor is marked `long`, is quick.
    """
    for item in items:
        if isinstance(item, pytest.Function) and (item.get_closest_marker("realtime") or _in_real_time(item.module)):
            item.add_marker(pytest.mark.realtime)
            item.add_marker(pytest.mark.xdist_group("real time"))
        if item.get_closest_marker("realtime") or (
            isinstance(item, pytest.Function) and _uses(item.module, _PROCESSES)
        ):
            item.add_marker(pytest.mark.flaky(reruns=1, reruns_delay=5))
        elif not any(map(item.get_closest_marker, ("slow", "soak", "long"))) and _is_quick(item):
            item.add_marker(pytest.mark.quick)
        if item.get_closest_marker("soak"):
            item.add_marker(pytest.mark.timeout(0))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile before many tests what they use most, so that no single one of them takes as long as that.

    Among slow tests that is all there is. Each worker begins with others, leaves out what another one compiles just
    now, and waits for that in the end.
    """
    gc.collect()
    gc.freeze()  # tests and modules stay: no collection of garbage need go through them
    many = sum(item.get_closest_marker("quick") is None for item in session.items) > 1000
    if not many or session.config.option.collectonly or no_compiler() is not None:
        return
    makers = catalogue.makers()
    names = [next(iter(catalogue.of_coupling("pspm"))), real_time.SERVO]
    if any(item.get_closest_marker("slow") for item in session.items):
        names += sorted(set(makers) - set(names))
    first = len(names) * WORKER // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    for wait in (False, True):
        for name in (*names[first:], *names[:first]):
            with background.alone(name, wait=wait) as here:
                if here and not sources.are_compiled(name):
                    makers[name]()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """The other workers' tests give way to those in real time: they have what is left of the processors."""
    if "PYTEST_XDIST_WORKER" in os.environ and item.get_closest_marker("xdist_group") is None:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def _in_real_time(module: ModuleType) -> bool:
    """Whether a module of tests uses what runs in real time, and is none that starts processes in virtual time only."""
    return not module.__name__.startswith(_VIRTUAL_TIME) and _uses(module, _REAL_TIME)


def _is_quick(item: pytest.Item) -> bool:
    """No part of its module makes whole runs, waits for real time, or starts processes; not through a helper either."""
    return isinstance(item, pytest.Function) and not _reaches(item.module, (*_REAL_TIME, *_PROCESSES, *_WHOLE_RUNS))


def _uses(module: ModuleType, homes: tuple[str, ...]) -> bool:
    """Whether it has imported any of these modules, or something out of one."""
    return any(home.startswith(homes) for home in _homes(module))


@cache
def _reaches(module: ModuleType, homes: tuple[str, ...]) -> bool:
    """Whether it uses any of these modules, or a helper of the tests that does."""
    helpers = {name for name in _homes(module) if name.startswith("tests.")} - {__name__, module.__name__}
    return _uses(module, homes) or any(_reaches(sys.modules[name], homes) for name in helpers)


@cache
def _homes(module: ModuleType) -> set[str]:
    """Where all that a module knows is from."""
    values = vars(module).values()
    return {str(getattr(value, "__module__", None) or getattr(value, "__name__", "")) for value in values}


def mostly_slow(values: Iterable[object], first: int, last: int | None = None) -> list[Any]:
    """Of parameters, a tuple for several names: the `first` in every run, those up to `last` in the slow one.

    The rest are run by hand; last : None: there is no such rest.
    """

    def marks(i: int) -> list[pytest.MarkDecorator]:
        if last is not None and i >= last:
            return [pytest.mark.soak]
        return [pytest.mark.slow] * (i >= first)

    return [
        pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=marks(i)) for i, each in enumerate(values)
    ]


@pytest.fixture(autouse=True)
def _handlers_as_before() -> Iterator[None]:
    """A test that leaves another handler of a signal, or blocks one, would be the next one's failure."""
    before, blocked = [signal.getsignal(number) for number in _SIGNALS], signal.pthread_sigmask(signal.SIG_BLOCK, ())
    yield
    left = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    assert left == blocked
    assert [signal.getsignal(number) for number in _SIGNALS] == before


@pytest.fixture
def handwriting() -> Path:
    """The recorded hand, or a skip where the recorded inputs are not at hand."""
    file = DATA / "hand" / "handwriting.csv"
    if not file.exists():
        pytest.skip(f"the recorded inputs are not there: {file.parent.name}/{file.name}")
    return file


def random_spd(rng: np.random.Generator, n: int, low: float, high: float) -> Array:
    """A random SPD matrix with eigenvalues spread log-uniformly between `low` and `high`."""
    basis, _ = np.linalg.qr(rng.normal(size=(n, n)))
    values = np.exp(rng.uniform(np.log(low), np.log(high), size=n))
    matrix = (basis * values) @ basis.T
    return np.asarray((matrix + matrix.T) / 2.0)


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the certificates of an authority, a world on 127.0.0.1 and the devices alice and bob.

    In `other` beside them: those of another authority, for the same names.
    """
    from examples.secure.make_certificates import main

    directory = tmp_path_factory.mktemp("certificates")
    for out in (directory, directory / "other"):
        main(host=["127.0.0.1", "localhost"], device=["alice", "bob", "viewer"], out=out)
    return directory
