"""A side under attack by mutated messages; and that all is well when it is over."""

import random
import traceback

from hapnet.side.endpoint import DeviceEndpoint, backlog
from hapnet.wire.messages import Motion, Port, Proxy, Wave
from hapnet.wire.session import Session, SessionSettings
from tests.fuzzing.corpus import seeds
from tests.fuzzing.decoder import Broken, decoded, hold
from tests.fuzzing.invariants import Watch
from tests.fuzzing.mutator import HELLO, Mutator
from tests.fuzzing.rig import LONG_SILENCE_S, MS, SILENCE_S, US, Rig, drawn_setup

STREAMS: dict[str, type[Motion | Port | Wave | Proxy]] = {"motion": Motion, "port": Port, "wave": Wave, "proxy": Proxy}
TARGETS = ("decoder", "device", "continuous", "world", *STREAMS)
STORM = 5_000
"""Messages in a storm; a storm has one seed, and its side and peer begin with it."""

_PAUSES_NS = (0, 20 * US, 100 * US, 500 * US, 5 * MS, 60 * MS)
_PAUSE_WEIGHTS = (20, 65, 93, 99.5, 99.9, 100)  # cumulative
_CHECK_MEMORY = 100
_RESTART_AFTER = 50  # messages that an honest peer waits unpaired before it starts anew
_OUTSIDERS = 0.3  # share of the storms in which nobody speaks in the peer's name
SEEDS = tuple(seeds().values())


def run(target: str, seed: int, count: int) -> None:
    """One storm of `count` messages. Raises AssertionError with all that is needed to see it again."""
    storm = _decoder if target == "decoder" else _stream if target in STREAMS else _endpoint
    progress: list[bytes] = []
    try:
        storm(target, random.Random(seed), count, progress)
    except Exception as error:
        where = "" if isinstance(error, Broken) else f"\n{traceback.format_exc()}"
        last = progress[-1].hex() if progress else "none"
        raise AssertionError(
            f"{type(error).__name__}: {error}{where}\nafter message {len(progress)} of {target}, seed {seed}: {last}\n"
            f"again: python -m tests.fuzzing --target {target} --seed {seed} --count {count}"
        ) from None


def run_many(target: str, seed: int, count: int, storm: int = STORM) -> None:
    """`count` messages in storms, with seeds from `seed` on."""
    for index in range(-(-count // storm)):
        run(target, seed + index, min(storm, count - index * storm))


def _decoder(target: str, rng: random.Random, count: int, progress: list[bytes]) -> None:
    own, peer = rng.getrandbits(64) | 1, rng.getrandbits(64) | 1
    mutator = Mutator(rng, SEEDS, own=own, role="device", dof=rng.choice((1, 2, 3, 6)))
    mutator.peer = peer
    taken = 0
    for _ in range(count):
        frame = mutator.next()
        progress.append(frame)
        message = decoded(frame)
        if message is not None:
            taken += 1
            mutator.overhear(frame)
    hold(count < 100 or 0.05 * count < taken < 0.95 * count, taken, "of", count, "messages are good: a dull storm")


def _endpoint(target: str, rng: random.Random, count: int, progress: list[bytes]) -> None:
    outsider = rng.random() < _OUTSIDERS  # in that case the honest peer shall not seem silent
    rig = Rig(target, rng, drawn_setup(target, rng, LONG_SILENCE_S if outsider else SILENCE_S))
    session, watch = rig.session, rig.watch
    mutator = Mutator(rng, SEEDS, own=session.identity.incarnation, role=rig.peer_role, dof=rig.dof, outsider=outsider)

    def overhear(frame: bytes) -> None:
        mutator.overhear(frame)
        if frame[1:3] == bytes((2, HELLO)):
            mutator.hellos = rig.session._handshake.control.hellos

    rig.overheard = overhear
    rig.run(500 * MS)
    hold(rig.paired, "the honest pair did not come about")
    unpaired = 0
    for index in range(count):
        rig.run(rng.choices(_PAUSES_NS, cum_weights=_PAUSE_WEIGHTS)[0])
        if index % 10 == 0:
            rig.honest_position()
            rig.honest.shuffle(rng.random() * 1e-5)
        mutator.peer = session.peer.incarnation if session.peer else rig.honest.identity.incarnation
        mutator.reported = watch._told_nJ
        frame = mutator.next()
        progress.append(frame)
        rig.attack(frame)
        rig.talk()
        unpaired = 0 if rig.paired else unpaired + 1
        if unpaired > _RESTART_AFTER:
            rig.restart()
            rig.run(30 * MS)
            unpaired = 0
        hold(not (outsider and unpaired), "somebody who cannot speak in the peer's name ended the pair")
        if index % _CHECK_MEMORY == 0:
            watch.check_memory()
    watch.check_memory()
    restarts = rig.restarts
    rig.recover()
    hold(not outsider or restarts == rig.restarts == 0, "the accounts of a pair were touched from outside")
    watch.check_memory()
    hold(rig.plant.updates > 0, "no update of the modulator was seen")


def _stream(target: str, rng: random.Random, count: int, progress: list[bytes]) -> None:
    """The wire half of a device whose coupling takes something else than positions; no servo takes what comes."""
    kind, dof = STREAMS[target], rng.choice((1, 2, 3))
    stale = rng.random() < 0.5
    settings = SessionSettings(expects=kind, accept_stale=stale, admission_W=5.0, admission_burst_J=0.5)
    endpoint = DeviceEndpoint(
        Session(role="device", dof=dof, name="pen", incarnation=rng.getrandbits(64) | 1, settings=settings)
    )
    session = endpoint.session
    watch = Watch(endpoint, power_W=5.0, burst_J=0.5, accept_stale=stale)
    mutator = Mutator(rng, SEEDS, own=session.identity.incarnation, role="world", dof=dof, stream=kind.KIND)
    honest = Session(role="world", dof=dof, name="wall", incarnation=rng.getrandbits(64) | 1)
    now_ns, unpaired, taken = 0, 0, 0
    for index in range(count):
        now_ns += rng.choices(_PAUSES_NS, cum_weights=_PAUSE_WEIGHTS)[0]
        unpaired = 0 if session.peer is not None and session.peer == honest.identity else unpaired + 1
        if unpaired > 3 * _RESTART_AFTER:
            honest, unpaired = Session(role="world", dof=dof, name="wall", incarnation=rng.getrandbits(64) | 1), 0
            now_ns += 1_000 * MS
        for _, data in watch.poll(now_ns):
            honest.receive(now_ns, data)
        mutator.hellos = session._handshake.control.hellos
        said = [data for _, data in honest.poll(now_ns)[0]]
        if index % 10 == 0:
            said.append(_sample(kind, honest, now_ns, tuple(rng.uniform(-1.0, 1.0) for _ in range(dof)), index))
        for data in said:
            mutator.overhear(data)
            watch.receive(now_ns, data)
        mutator.peer = session.peer.incarnation if session.peer else honest.identity.incarnation
        mutator.reported = watch._told_nJ
        frame = mutator.next()
        progress.append(frame)
        taken += bool(watch.receive(now_ns, frame))
        endpoint.credits.clear()
        hold(len(endpoint.waiting) <= backlog(kind), len(endpoint.waiting), "wait")
        if index % _CHECK_MEMORY == 0:
            watch.check_memory()
    hold(count < 1000 or taken > 0.02 * count, taken, "of", count, "messages were taken: a dull storm")


def _sample(
    kind: type[Motion | Port | Wave | Proxy], honest: Session, now_ns: int, value: tuple[float, ...], index: int
) -> bytes:
    """The next message of the honest peer's stream."""
    if kind is Motion:
        return honest.positions.motion(now_ns, value, value)
    if kind is Port:
        return honest.positions.port(now_ns, value, index)
    if kind is Proxy:
        plane = ((1.0, *(0.0,) * (len(value) - 1)), 0.01, 3000.0, 10.0, 0.0)
        return honest.positions.proxy(now_ns, value, index, value, (plane,) if index % 3 else None)
    return honest.positions.wave(now_ns, value, 5 * MS)
