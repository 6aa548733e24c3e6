"""PD control of both sides over a delay (Lee, Spong, IEEE T-RO 22(2), 2006), between the device and the virtual mass.

Each side acts with its own motion and what the other one's was when it was sent; R is the round trip:

    tau = -K_v (v - v_peer) - (K_d + P_e) v - K_p (x - x_peer)         passive if K_d >= K_p R / 2

Why (the law is the paper's, this is derived here): beside the storage K_p/2 (x_1 - x_2)^2 either side spends K_p v
times the other side's way since its sample was sent. Where no sample is older than D_1, D_2 that is, over time, at
most K_p (D_1 + D_2)/2 times each side's integral of v^2, which is what K_d dissipates. So for the spring the delay may
vary below its bound; for K_v it must be constant. A sample that is lost leaves one that is older than the bound:
of that nothing is said.

R counts the holding of data too. The device's are sent every few ticks; the world's once a step of length T, and it
acts with what it has for a step. As its velocity over a step is one number, both together cost it T in the mean; the
device as well, while its motion is slow beside a step (2 T at worst).

The world's end is implicit in the step's mean velocity, and with x_peer held passive exactly. The device's is held: to
be passive for any motion it needs damping of its own of more than K_p T/2 + K_d + P_e + K_v, T the servo's period
(Colgate, Schenkel 1997); without it is so for motions that are slow beside a tick.

Ends that start apart start with the spring's energy K_p/2 (x_1 - x_2)^2.
"""

from __future__ import annotations

from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Motion


class Gains(NamedTuple):
    """Of both ends, the same."""

    stiffness: float  #: K_p [N/m]
    damping: float  #: K_d [Ns/m], which pays for the delay
    coordination: float = 0.0  #: K_v [Ns/m]
    extra: float = 0.0  #: P_e [Ns/m]

    @property
    def drag(self) -> float:
        """All that multiplies a side's own velocity [Ns/m]."""
        return self.damping + self.extra + self.coordination


def round_trip(link: float, period: float, step: float, tick: float) -> float:
    """R [s]: of the link, with the device's sending period, the longest step of the world and the servo's tick."""
    return link + period + step + tick


def tuned(stiffness: float, round_trip: float, most: float) -> Gains:
    """K_p = `stiffness` [N/m], or less where K_d = K_p R/2 would be more than `most` [Ns/m] of damping."""
    K_p = min(stiffness, 2.0 * most / round_trip)
    return Gains(K_p, K_p * round_trip / 2.0)


class _End:
    """What both ends have.

    Parameters
    ----------
    gains : of the law. position : x(0) [m], of this side; the other one is taken to rest there too.
    """

    def __init__(self, gains: Gains, position: Vector) -> None:
        self._gains = gains
        self._rest: Vector = (0.0,) * len(position)
        self._peer = Motion(position, self._rest)

    @property
    def set_position(self) -> Vector:
        """x_peer [m]."""
        return self._peer.position

    def receive(self, sample: CouplingSample) -> None:
        """The other side's motion came."""
        assert isinstance(sample, Motion), "a motion is what either side sends here"
        self._peer = sample

    def on_peer_changed(self) -> None:
        """Another peer: until it tells, it rests where the first one was."""
        self._peer = Motion(self._peer.position, self._rest)


class DevicePD(_End):
    """The device's end."""

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """The force to hold [N]; the arguments are those of `DeviceLaw.force`."""
        K_p, K_v, drag = self._gains.stiffness, self._gains.coordination, self._gains.drag
        return tuple(
            [
                K_v * speed_peer - drag * speed - K_p * (at - peer)
                for at, speed, peer, speed_peer in zip(x, v, *self._peer, strict=True)
            ]
        )

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """The spring is tied to x until something arrives."""
        self._peer = Motion(x, self._rest)

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        """The motion."""
        return Motion(x, v)


class WorldPD(_End):
    """The world's end."""

    def __init__(self, gains: Gains, position: Vector) -> None:
        super().__init__(gains, position)
        self._latched = self._own = self._peer

    def begin(self) -> None:
        """A step acts with the newest motion at its onset."""
        self._latched = self._peer

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """Drag K_v + K_d + P_e + K_p T/2 [Ns/m], push K_v v_peer - K_p (x - x_peer) [N]."""
        K_p, K_v = self._gains.stiffness, self._gains.coordination
        push = [
            K_v * speed - K_p * (at - peer) for at, peer, speed in zip(self._own.position, *self._latched, strict=True)
        ]
        return self._gains.drag + 0.5 * K_p * dt, tuple(push)

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        """The step's end, and its mean velocity: that is what the other side is told, v may alternate about it."""
        self._own = Motion(x, vhat)

    def next_sample(self) -> CouplingSample:
        """The motion."""
        return self._own
