"""Messages to attack with: an endless, seeded stream of frames, most of them broken, some of them forged well.

Three kinds of attacker take turns. One damages bytes, as a broken wire would. One rewrites msgpack values, as a broken
program would. The third knows the protocol and listens in: it forges frames that fit the talk it heard.
"""

import math
import random
from collections import deque
from collections.abc import Callable, Iterable

import msgpack

INCARNATION, SEQUENCE = 2, 3
POSITION, ENERGY, HELLO, WELCOME, REFUSE, BYE, MOTION, PORT, WAVE, PROXY, SIGNALS, ACCOUNT, ENCRYPTED = range(1, 14)
STREAMS = (POSITION, MOTION, PORT, WAVE, PROXY)
MOST_RECORDED = 64

NAN = float("nan")
ODD_NUMBERS = (0, 1, -1, 2, 64, 65, 2**31, 2**32, 2**53 - 1, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63))
ODD_FLOATS = (
    0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1e-160, 1e6, -1e6, 1000000.0000000001, 1e308, NAN, math.inf, -math.inf,
)  # fmt: skip
ODD_TEXTS = ("", "device", "world", "x" * 256, "x" * 257, "line\nend", "\x00", "\u202e", "coupling", "\U0001f9ff" * 64)
ODD_VALUES: tuple[object, ...] = (
    *ODD_NUMBERS, *ODD_FLOATS, *ODD_TEXTS, None, True, False, b"", b"bytes" * 9, [], [[]], {}, {"a": {}}, {1: 2},
    [0.0], [0.5] * 3, [0.5] * 64, [0.5] * 65, [0] * 400, ["x"] * 400, {f"k{i}": i for i in range(33)},
    msgpack.ExtType(7, b"ext"), msgpack.Timestamp(1, 2), [[[[[[[[]]]]]]]],
)  # fmt: skip


class Mutator:
    """An endless stream of frames.

    rng : of everything; the same state and the same calls give the same frames.
    seeds : frames to begin with.
    own : incarnation of the side under attack.
    role, dof : of the attacker, that is of the peer it plays.
    outsider : it can repeat what it hears and shout in other names, but not speak in the peer's.
    stream : the kind of what it says all the time; mostly, at least.
    """

    def __init__(
        self,
        rng: random.Random,
        seeds: Iterable[bytes],
        *,
        own: int,
        role: str,
        dof: int,
        outsider: bool = False,
        stream: int = POSITION,
    ) -> None:
        self.rng = rng
        self.own, self.role, self.dof, self.outsider, self.stream = own, role, dof, outsider, stream
        self.peer = 0
        """Whom the side under attack takes for its peer; the rig keeps it up to date."""
        self.strangers = [rng.getrandbits(64) | 1 for _ in range(3)]
        self.hellos = 0
        """Number of the last hello of the side under attack."""
        self.reported = 0
        """Total of its last energy message [nJ]."""
        self._seeds = list(seeds)
        self._values = [value for value in map(_value, self._seeds) if isinstance(value, list) and value]
        self._recorded: deque[bytes] = deque(maxlen=MOST_RECORDED)
        self._sequence = self._total = self._sent_ns = self._told_signals = self._told_accounts = 0
        plan: tuple[tuple[Callable[[], bytes], float], ...] = (
            (self._flipped, 10), (self._cut, 5), (self._padded, 3), (self._spliced, 5), (self._noise, 2),
            (self._retyped, 18), (self._resized, 5), (self._seed, 3), (self._replayed, 10),
            (self._position, 16), (self._energy, 14), (self._hello, 5), (self._welcome, 3),
            (self._parting, 0.3), (self._version, 1), (self._deep, 0.7), (self._signals, 2), (self._account, 2),
            (self._encrypted, 1),
        )  # fmt: skip
        self._ways = [way for way, _ in plan]
        self._weights = list(_running(weight for _, weight in plan))

    def overhear(self, frame: bytes) -> None:
        """A frame that somebody honest sent, to be replayed, damaged and learnt from."""
        self._recorded.append(frame)

    def next(self) -> bytes:
        """The next frame to attack with."""
        return self.rng.choices(self._ways, cum_weights=self._weights)[0]()

    # -- damaged bytes ----------------------------------------------------------------------------------------------

    def _any(self) -> bytes:
        if self._recorded and not self.outsider and self.rng.random() < 0.6:
            return self.rng.choice(self._recorded)
        return self.rng.choice(self._seeds)

    def _flipped(self) -> bytes:
        data = bytearray(self._any())
        for _ in range(1 + int(self.rng.expovariate(1.0))):
            if data:
                data[int(self.rng.random() * len(data))] ^= 1 << int(self.rng.random() * 8)
        return bytes(data)

    def _cut(self) -> bytes:
        data = self._any()
        at = int(self.rng.random() * (len(data) + 1))
        return data[:at] if self.rng.random() < 0.7 else data[at:]

    def _padded(self) -> bytes:
        pad = self.rng.choice((b"\x00", b"\xc0", b"\xc1", b"\x00" * 4096, self._any()))
        return self._any() + pad if self.rng.random() < 0.7 else pad + self._any()

    def _spliced(self) -> bytes:
        one, other = self._any(), self._any()
        return one[: int(self.rng.random() * (len(one) + 1))] + other[int(self.rng.random() * (len(other) + 1)) :]

    def _noise(self) -> bytes:
        head = (
            b""
            if self.rng.random() < 0.5
            else bytes((0x90 + int(self.rng.random() * 16), 2, int(self.rng.random() * 8)))
        )
        return head + self.rng.randbytes(int(self.rng.expovariate(1 / 30)))

    def _deep(self) -> bytes:
        header = self.rng.choice(
            (b"\x91", b"\x81\xa1a", b"\xdc\x00\x41", b"\xdc\x0f\xff", b"\xdd\x00\x00\x0f\xff", b"\xde\x00\x01")
        )
        return b"\x98\x02\x03" + header * int(self.rng.random() * (4200 // len(header)))

    # -- rewritten values -------------------------------------------------------------------------------------------

    def _elements(self) -> list[object]:
        if self._recorded and not self.outsider and self.rng.random() < 0.5:
            value = _value(self.rng.choice(self._recorded))
            if isinstance(value, list):
                return value
        return list(self.rng.choice(self._values))

    def _retyped(self) -> bytes:
        """One element in place of another, or inside an array or a map."""
        elements = self._elements()
        if self.rng.random() < 0.5 and len(elements) > 3:
            elements[INCARNATION] = self._who()
        at = int(self.rng.random() * len(elements))
        inner = elements[at]
        if isinstance(inner, list) and inner and self.rng.random() < 0.7:
            inner = list(inner)
            inner[int(self.rng.random() * len(inner))] = self._odd()
            elements[at] = inner
        elif isinstance(inner, dict) and self.rng.random() < 0.7:
            elements[at] = {**inner, self.rng.choice(ODD_TEXTS): self._odd()}
        else:
            elements[at] = self._odd()
        return _packed(elements)

    def _resized(self) -> bytes:
        elements = self._elements()
        at = int(self.rng.random() * (len(elements) + 1))
        if self.rng.random() < 0.5:
            elements.insert(at, self._odd())
        else:
            del elements[at : at + 1]
        return _packed(elements)

    def _odd(self) -> object:
        return self.rng.choice(ODD_VALUES)

    # -- forged by somebody who listens -----------------------------------------------------------------------------

    def _who(self) -> int:
        """Whose name a forgery bears: mostly the peer's, since that is what gets in."""
        r = self.rng.random()
        if r < 0.7:
            return self.strangers[0] if self.outsider or not self.peer else self.peer
        if r < 0.9:
            return self.rng.choice(self.strangers)
        return self.rng.choice((0, self.own, 2**64 - 1, self.rng.getrandbits(64)))

    def _whom(self) -> int:
        return self.own if self.rng.random() < 0.93 else self.rng.choice((0, self.peer, *self.strangers))

    def _count(self, last: int, step: int, most: int) -> int:
        """A counter that goes on, and now and then back, or leaps."""
        r = self.rng.random()
        if r < 0.85:
            return min(most, last + 1 + int(self.rng.expovariate(1 / step)))
        if r < 0.995:
            return max(0, last - int(self.rng.expovariate(1 / step)))
        return self.rng.choice((0, most, most - 1, 2**53 + 1, 2**53 - 1, 2**32))

    def _position(self) -> bytes:
        r = self.rng.random
        sequence = self._count(self._sequence, 2, 2**64 - 1)
        self._sent_ns = self._count(self._sent_ns, 10**6, 2**64 - 1)
        if r() < 0.98:  # a leap stays one frame of many, or the rest would be stale
            self._sequence = min(sequence, self._sequence + 100)
        style = r()
        dof = self.dof if r() < 0.97 else int(r() * 66)
        if style < 0.4:
            position = [(r() - 0.5) * 0.2 for _ in range(dof)]
        elif style < 0.6:
            position = [(r() - 0.5) * 2e6 for _ in range(dof)]
        elif style < 0.8:
            sign = 1.0 if sequence % 2 else -1.0
            position = [sign * 1e6] * dof
        else:
            position = [self.rng.choice(ODD_FLOATS[:7] if r() < 0.8 else ODD_FLOATS) for _ in range(dof)]
        kind = self.stream if r() < 0.97 else self.rng.choice(STREAMS)
        more: dict[int, list[object]] = {
            MOTION: [position[: dof if r() < 0.99 else 1]],
            PORT: [self._count(self._total, 10**6, 2**63 - 1)],
            WAVE: [self._count(5 * 10**6, 10**7, 10**10)],
            PROXY: [self._count(self._sent_ns, 10**6, 2**64 - 1), position[:], self._planes(dof)],
        }
        echo = [self._count(self._sent_ns, 10**6, 2**64 - 1), self._count(self._sent_ns, 10**6, 2**64 - 1)]
        values = [position, *more.get(kind, [])]
        end = self._of_planes(values[-1]) if kind == PROXY and r() < 0.5 else self._further()
        if kind in (POSITION, PROXY) and r() < 0.5:
            end = self._of_reservoirs(end)
        return _packed([2, kind, self._who(), sequence, self._sent_ns, *values, *echo, *end])

    def _of_reservoirs(self, end: list[object]) -> list[object]:
        """These further entries with a level and, at times, a reach."""
        r = self.rng.random
        further = end[0] if end and isinstance(end[0], dict) else {}
        level = r() if r() < 0.9 else self.rng.choice(ODD_FLOATS) if r() < 0.5 else self._odd()
        reach = {"reach": 10 ** (8 * r() - 2) if r() < 0.95 else self._odd()} if r() < 0.3 else {}
        return [{**further, "level": level, **reach}]

    def _of_planes(self, planes: object) -> list[object]:
        """The contact planes' curvatures, their friction, or both; at times effects of their surfaces."""
        which = self.rng.random()
        curvatures = {"curvatures": self._curvatures(planes)} if which < 0.7 else {}
        effects = {"effects": self._effects(planes)} if 0.3 < which < 0.5 else {}
        return [curvatures | ({"friction": self._friction(planes)} if which > 0.4 else {}) | effects]

    def _effects(self, planes: object) -> object:
        r, odd = self.rng.random, self.rng.choice
        found: list[object] = []
        for plane in planes if isinstance(planes, list) else []:
            dof = len(plane[0]) if isinstance(plane, list) and plane and isinstance(plane[0], list) else 1
            numbers = [odd(ODD_FLOATS) if r() < 0.02 else most * r() ** 4 for most in (1e3, 10.0, 100.0, 0.1)]
            wave = [1e5 * (2.0 * r() - 1.0) for _ in range(dof if r() < 0.98 else 1)]
            shape = self.rng.randbytes(self.rng.choice((2, 16, 256) if r() < 0.98 else (0, 1, 257)))
            grain = [wave, 0.1 * r() ** 4, shape] if r() < 0.7 else None if r() < 0.9 else self._odd()
            found.append([*numbers, grain] if r() < 0.8 else None if r() < 0.9 else self._odd())
        return found if r() < 0.95 else self._odd()

    def _friction(self, planes: object) -> object:
        r = self.rng.random
        count = len(planes) if isinstance(planes, list) else 0
        odd = self.rng.choice
        friction = [odd(ODD_FLOATS) if r() < 0.02 else 10.0 * r() ** 4 for _ in range(count if r() < 0.98 else 2)]
        return friction if r() < 0.95 else self._odd()

    def _curvatures(self, planes: object) -> object:
        """How the contact planes' surfaces bend, mostly: across the normal's first two components."""
        r = self.rng.random
        bends: list[object] = []
        for plane in planes if isinstance(planes, list) else []:
            match plane:
                case [[float(first), float(second), *others], *_]:
                    size = math.hypot(first, second) or 1.0
                    way = [-second / size, first / size if r() < 0.98 else first] + [0.0] * len(
                        others if r() < 0.99 else ()
                    )
                case _:  # an odd one, or of one axis
                    way = [1.0]
            per_m = self.rng.choice(ODD_FLOATS) if r() < 0.05 else (r() - 0.6) * 10 ** (6 * r())
            bends.append([[way, per_m]] * int(r() * 1.7) if r() < 0.95 else self._odd())
        return bends if r() < 0.95 else self._odd()

    def _planes(self, dof: int) -> object:
        """Mostly planes; some of them with numbers that no plane has."""
        r = self.rng.random
        if r() < 0.2:
            return None
        if r() < 0.05:
            return self._odd()
        planes: list[object] = []
        for _ in range(int(r() * (4 if r() < 0.95 else 9))):
            way = [self.rng.gauss(0.0, 1.0) for _ in range(dof if r() < 0.98 else 2)]
            length = math.hypot(*way) or 1.0
            numbers = [(r() - 0.5) * 0.1, 10 ** (6 * r()), 10 * r(), r() - 0.5]
            if r() < 0.05:
                numbers[int(r() * 4)] = self.rng.choice(ODD_FLOATS)
            planes.append([[w / length if r() < 0.99 else w for w in way], *numbers])
        return planes

    def _further(self) -> list[object]:
        """What later programs may say at a frame's end; mostly nothing."""
        r = self.rng.random
        if r() < 0.9:
            return []
        return [{self.rng.choice(ODD_TEXTS): self._odd() for _ in range(int(r() * 4))} if r() < 0.9 else self._odd()]

    def _energy(self) -> bytes:
        total = self._count(self._total, 10**6, 2**63 - 1)
        if total < self._total + 10**8:
            self._total = total
        else:
            self._total = 0 if self.rng.random() < 0.5 else self._total
        r = self.rng.random()
        reported = self.reported
        if r < 0.85:
            acked = int(self.rng.random() * (reported + 1)) if r < 0.5 else reported
        else:
            acked = self.rng.choice((0, reported + 1, reported + 10**6, 2**63 - 1, 2**53))
        return _packed(
            [2, ENERGY, self._who(), self._whom(), 0 if self.rng.random() < 0.05 else total, acked, *self._further()]
        )

    def _signals(self) -> bytes:
        """Values beside the stream; never the word that stops a device, since that would be obeyed."""
        r = self.rng.random
        self._told_signals = self._count(self._told_signals, 2, 2**64 - 1)
        if r() < 0.05:
            self._told_signals = 0
        values: object = {
            f"signal {int(r() * 5)}": self.rng.choice(
                (r(), int(r() * 9), r() < 0.5, "words", None, [r(), r()], self._odd())
            )
            for _ in range(int(r() * (6 if r() < 0.97 else 40)))
        }
        values = values if r() < 0.95 else self._odd()
        return _packed([2, SIGNALS, self._who(), self._whom(), self._told_signals, values, *self._further()])

    def _account(self) -> bytes:
        """What a side may claim of itself, mostly with names that a summary has."""
        r = self.rng.random
        self._told_accounts = self._count(self._told_accounts, 2, 2**64 - 1)
        if r() < 0.05:
            self._told_accounts = 0
        names = ("ledger.margin_J", "ledger.bound_J", "sent_nJ", "credited_nJ", "stopped.why", "wall.springs_N_m", "x")
        values: object = {
            f"{self.rng.choice(names)}{'' if r() < 0.9 else int(r() * 90)}": r() if r() < 0.7 else self._odd()
            for _ in range(int(r() * (6 if r() < 0.97 else 200)))
        }
        values = values if r() < 0.95 else self._odd()
        heard = 0 if r() < 0.9 else self._count(0, 3, 2**64 - 1)
        flags = [r() < 0.5 if r() < 0.97 else self._odd() for _ in range(2)]
        return _packed([2, ACCOUNT, self._who(), self._whom(), self._told_accounts, heard, *flags, values])

    def _encrypted(self) -> bytes:
        """Of somebody who has no key."""
        r = self.rng.random
        number = self.rng.choice((self._sequence + 1, 2**63, self.rng.getrandbits(64)))
        content = self.rng.randbytes(17 + int(r() * 80)) if r() < 0.9 else self._odd()
        return _packed([2, ENCRYPTED, self._who(), number, content, *self._further()])

    def _hello(self) -> bytes:
        r = self.rng.random
        who = self.rng.getrandbits(64) if r() < 0.4 else self.rng.choice((*self.strangers, self.own))
        return _packed([2, HELLO, who, self._count(self.hellos, 2, 2**64 - 1), *self._identity(), *self._further()])

    def _welcome(self) -> bytes:
        r = self.rng.random
        number = self.hellos if r() < 0.6 else self._count(self.hellos, 3, 2**64 - 1)
        who = self.rng.choice(self.strangers) if r() < 0.7 else self.rng.getrandbits(64)
        return _packed([2, WELCOME, who, self._whom(), number, *self._identity(), *self._further()])

    def _identity(self) -> list[object]:
        r = self.rng.random
        role = self.role if r() < 0.9 else self.rng.choice(("device", "world", "observer"))
        dof = self.dof if r() < 0.9 else int(r() * 66)
        about: dict[object, object] = {"coupling": "pspm"} if r() < 0.8 else {"coupling": self._odd()}
        if r() < 0.1:
            about["earlier"] = self._odd()
        if r() < 0.1:
            about.update({f"key {i}": "v" * 60 for i in range(int(r() * 40))})
        return [role, dof, self.rng.choice(("pen", "wall")), about]

    def _parting(self) -> bytes:
        """A refusal or a bye in the peer's name; `strangers` are renewed, since they may be retired by now."""
        self.strangers[int(self.rng.random() * 3)] = self.rng.getrandbits(64) | 1
        if self.rng.random() < 0.3:
            return _packed([self.rng.choice((2, 2, 1, 0, 9, -1)), REFUSE, self._who(), self._whom(), "no"])
        return _packed([2, BYE, self._who(), self._whom(), self.rng.choice((0, self.reported, 2**62)), "the end"])

    def _version(self) -> bytes:
        """Another version's frame, in a stranger's name or the peer's; its elements may be anything."""
        who = self.rng.choice((*self.strangers, self.rng.getrandbits(64), self.own))
        kind = self.rng.choice((POSITION, ENERGY, HELLO, HELLO, WELCOME, BYE, 99))
        return _packed(
            [self.rng.choice(ODD_NUMBERS), kind, who, *[self._odd() for _ in range(int(self.rng.random() * 5))]]
        )

    # -- as it was --------------------------------------------------------------------------------------------------

    def _seed(self) -> bytes:
        return self.rng.choice(self._seeds)

    def _replayed(self) -> bytes:
        return self.rng.choice(self._recorded) if self._recorded else self._seed()


def _value(data: bytes) -> object:
    """What `data` says, if it is msgpack at all."""
    try:
        return msgpack.unpackb(data, strict_map_key=False, max_array_len=100)
    except (ValueError, TypeError, msgpack.UnpackException):
        return None


def _packed(elements: list[object]) -> bytes:
    try:
        return bytes(msgpack.packb(elements))
    except (ValueError, OverflowError):  # a text that came in pieces, or an integer beyond 64 bits
        return b"\xc1"


def _running(weights: Iterable[float]) -> Iterable[float]:
    total = 0.0
    for weight in weights:
        total += weight
        yield total
