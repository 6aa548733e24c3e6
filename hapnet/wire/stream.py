"""A side's stream: the messages that it sends all the time, numbered, stamped and encoded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgpack

from hapnet.records.record import OfAxes, Reals, Record, equation
from hapnet.wire.fields import CURVATURES, EFFECTS, FRICTION, INTEGRAL, LEVEL, REACH
from hapnet.wire.messages import Motion, Port, Position, Proxy, Wave
from hapnet.wire.stream_frames import echo_of, encode_position, encode_stream, level_of, start_of

BACKLOG = 128
"""The most waves or positions of a stream that wait for the next tick of the side that uses them."""


class PositionStream:
    """Numbers and encodes the positions of one incarnation, or the messages that its coupling sends instead.

    It shares no state with the rest of a session, so it may run in another thread or process.
    """

    def __init__(self, incarnation: int) -> None:
        self.next_sequence: int = 0
        self._start = start_of(Position.KIND, incarnation, 1)
        self._start_of_level = start_of(Position.KIND, incarnation, 2)
        self._starts = {kind: start_of(kind, incarnation, 2) for kind in (Motion.KIND, Port.KIND)}
        self._starts[Wave.KIND] = start_of(Wave.KIND, incarnation, 3)  # with a further entry
        self._starts[Proxy.KIND] = start_of(Proxy.KIND, incarnation, 4)
        self._start_of_more = start_of(Proxy.KIND, incarnation, 5)
        self._pack: Callable[..., bytes] = msgpack.Packer().pack
        self._echo = echo_of(0, 0)
        self.integral: Integral = Integral()

    def echo(self, sent_ns: int, came_ns: int) -> None:
        """Let the next messages echo `sent_ns`, the stamp of the peer's message that came last, at `came_ns`."""
        self._echo = echo_of(sent_ns, came_ns)

    def position(self, now_ns: int, position: Sequence[float], level: float | None = None) -> bytes:
        """The next frame for the position key: `position` [m or rad], `dof` finite coordinates (not checked here).

        level : how full this side's reservoir is, 0 to 1; None: no level is sent.
        """
        sequence = self.next_sequence
        self.next_sequence = sequence + 1
        if level is None:
            return encode_position(self._start, sequence, now_ns, _floats(position), self._echo, self._pack)
        end = self._echo + level_of(level)
        return encode_position(self._start_of_level, sequence, now_ns, _floats(position), end, self._pack)

    def motion(self, now_ns: int, position: Sequence[float], velocity: Sequence[float]) -> bytes:
        """The next frame: a position [m] with its velocity [m/s]."""
        return self._next(self._starts[Motion.KIND], now_ns, (_floats(position), _floats(velocity)))

    def port(self, now_ns: int, value: Sequence[float], energy_nJ: int) -> bytes:
        """The next frame: a port's position [m] or force [N], and all the energy that went in at this port so far."""
        return self._next(self._starts[Port.KIND], now_ns, (_floats(value), energy_nJ))

    def wave(self, now_ns: int, wave: Sequence[float], span_ns: int) -> bytes:
        """The next frame: a wave [sqrt(W)], the mean over `span_ns`, with the integral of all waves so far."""
        wave, integral = _floats(wave), self.integral
        integrate(integral, len(wave), wave, span_ns)
        frame = self._next(self._starts[Wave.KIND], now_ns, (wave, span_ns))
        return frame + self._pack({INTEGRAL: (integral.total[: len(wave)], integral.elapsed_ns)})

    def proxy(
        self,
        now_ns: int,
        position: Sequence[float],
        aimed_ns: int,
        force: Sequence[float],
        planes: Sequence[Sequence[Any]] | None,
        reach_m: float | None = None,
        level: float | None = None,
    ) -> bytes:
        """The next frame: the proxy's position [m], the device's time for which it stands, and the planes around it.

        A plane's sixth to eighth elements, if it has them, are its curvatures, friction and effects. reach_m : the
        distance within which there are no other planes [m]. level : how full this side's reservoir is, 0 to 1. None:
        the entry is not sent.
        """
        sent_planes = None if planes is None else tuple([(_floats(n), *map(float, rest[:4])) for n, *rest in planes])
        values = (_floats(position), aimed_ns, _floats(force), sent_planes)
        bends = tuple([tuple([(_floats(e), float(k)) for e, k in _after(plane, 5, ())]) for plane in planes or ()])
        friction = tuple([float(_after(plane, 6, 0.0)) for plane in planes or ()])
        effects = tuple([_after(plane, 7, None) for plane in planes or ()])
        about = ((CURVATURES, bends), (FRICTION, friction), (EFFECTS, effects))
        more: dict[str, Any] = {name: each for name, each in about if any(each)}
        more.update({name: each for name, each in ((REACH, reach_m), (LEVEL, level)) if each is not None})
        if not more:
            return self._next(self._starts[Proxy.KIND], now_ns, values)
        return self._next(self._start_of_more, now_ns, values) + self._pack(more)

    def _next(self, start: bytes, now_ns: int, values: tuple[Any, ...]) -> bytes:
        sequence = self.next_sequence
        self.next_sequence = sequence + 1
        return encode_stream(start, sequence, now_ns, values, self._echo, self._pack)


def _floats(vector: Sequence[float]) -> tuple[float, ...]:
    """Convert coordinates to floats: a peer refuses integers."""
    return tuple(map(float, vector))


def _after(plane: Sequence[Any], count: int, otherwise: Any) -> Any:
    return plane[count] if len(plane) > count else otherwise


class Integral(Record):
    """total : the integral of all waves so far [sqrt(W) s]. elapsed_ns : the sum of their spans."""

    total: OfAxes
    elapsed_ns: int


@equation
def integrate(integral: Integral, n: int, wave: Reals, span_ns: int) -> None:
    """Add a wave [sqrt(W)], the mean over `span_ns`."""
    seconds = span_ns * 1e-9
    for i in range(n):
        integral.total[i] = integral.total[i] + wave[i] * seconds
    integral.elapsed_ns += span_ns
