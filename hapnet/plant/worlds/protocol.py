"""The protocol of a world: the proxy's start and surroundings, the length of a step, and a picture.

`hapnet.mechanics.contacts.Surroundings` has the equations of the forces on the proxy. A world of the user's own is
completed when it is loaded (`hapnet.ext.engines.own_worlds`), so every world has all of these methods.
"""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Signal, Vector
from hapnet.mechanics.contacts import Mass, Surroundings
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.picture import Picture, SeenHand
from hapnet.units import METRES

if TYPE_CHECKING:
    from hapnet.plant.worlds.walls import Wall


class Surface(NamedTuple):
    """A wall perpendicular to an axis, as a plot draws it: a line at one coordinate, hatched on its solid side."""

    axis: int  #: index of the coordinate
    position_m: float
    solid: int  #: +1: solid at larger coordinates, -1: at smaller ones


class WorldDefaults(Protocol):
    """The parts of a `World` that have defaults."""

    moves_proxy: bool = False
    """True: it integrates the proxy itself; only couplings with a spring at the world fit; `proxy` returns the mass."""

    robot: bool = False
    """True: it moves a robot to the proxy's position. So nothing moves while the device is released, and afterwards the
    device leads from its new position."""

    @property
    def jaw(self) -> bool:
        """Whether its last axis is the opening of a jaw, which a device or a robot then needs."""
        return False

    @property
    def rest(self) -> Vector:
        """Where a simulated hand's motion begins (n,) [m]; empty: at the origin."""
        return ()

    @property
    def pressed(self) -> Vector:
        """The direction in which a simulated hand presses (n,); empty: along the first axis."""
        return next((wall.normal for wall in self.walls), ())

    @property
    def has_effects(self) -> bool:
        """Whether a surface has effects (drag, grain, snap), which only a contact model at the device renders."""
        return False

    @property
    def units(self) -> str:
        """The units of its axes: ``m``, ``rad``, or one for each as in ``m,m,rad`` (`hapnet.units`)."""
        return METRES

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Its flat walls at rest, for metrics; other obstacles are left out."""
        return ()

    @property
    def stiffnesses(self) -> tuple[float, ...] | None:
        """The stiffnesses of its walls and solids [N/m]; None: it has neither, or they are not known."""
        return tuple([wall.stiffness for wall in self.walls]) or None

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The surfaces that plots draw."""
        return ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user."""
        return ()

    @property
    def hands(self) -> tuple[SeenHand, ...]:
        """The hands of a world with several, this one among them, for pages. Called on the event loop."""
        return ()

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> Mass | None:
        """The proxy on its coupling with B' [Ns/m] and K' [N/m]; `mass` [kg] applies to a proxy that the world added.

        None: the passive integrator moves the proxy.
        """
        return None

    def picture(self) -> Picture | None:
        """Return its picture; None: it cannot be drawn."""
        return None

    def steps_between(self, min_s: float, max_s: float) -> bool:
        """Draw the steps' length from this range [s]; False: it has its own."""
        return False

    def for_hand_at(self, at: Vector) -> World | None:
        """The same world for one of several hands, whose device's origin is at `at` (n,) [m]; None: it has room for one
        hand only.
        """
        return None

    def environment_account(self, contacts: Surroundings, position: Vector) -> EnvironmentAccount:
        """The account of its `contacts` from now on, with the proxy at `position` (n,) [m]."""
        return EnvironmentAccount(contacts, position)

    def open(self) -> None:
        """Open what it moves, such as a robot, before control starts: in the process and the thread that made it.

        Raises HapnetError, InvalidParameter: it cannot be opened.
        """
        return

    def close(self) -> None:
        """Stop and release what it moves. Called after the last step; may be called again."""
        return

    def heard(self, now_ns: int, came_ns: int, took_ns: int) -> None:
        """Receive the time before each step of a robot's world, when the leader's newest position came, and the time
        that it took [ns]; below 0: none came yet."""
        return

    def signal(self, name: str, value: Signal) -> None:
        """Receive a value that the device's side sends beside the stream."""
        return

    def signals(self) -> Mapping[str, Signal]:
        """The values to send to the device's side beside the stream."""
        return {}


@runtime_checkable
class World(WorldDefaults, Protocol):
    """A world that a user can choose."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Its name in summaries and figures."""

    @property
    @abstractmethod
    def dof(self) -> int: ...

    @property
    @abstractmethod
    def start(self) -> Vector:
        """The proxy's start position (n,) [m], outside every obstacle."""

    @property
    @abstractmethod
    def contacts(self) -> Surroundings: ...

    @abstractmethod
    def next_step_s(self, rng: np.random.Generator) -> float:
        """Duration of the next step, T_k [s]."""

    @abstractmethod
    def towards(self, position: Vector) -> Vector:
        """The farthest point on the straight line from `start` to `position` (n,) [m] where a proxy can be placed."""


def lacking(part: object, names: Iterable[str]) -> list[str]:
    """The attributes in `names` that `part` lacks."""
    return sorted(name for name in names if not hasattr(part, name))


def is_world(part: object) -> TypeGuard[World]:
    """Whether `part` has all required attributes of a world. A class that makes worlds is not a world."""
    return not isinstance(part, type) and not lacking(part, World.__abstractmethods__)


class Completed:
    """A user's part `own`, with a protocol's defaults for the attributes that it lacks."""

    def __init__(self, own: object, protocol: type) -> None:
        self._own, self._protocol = own, protocol

    def __getattr__(self, name: str) -> Any:
        if hasattr(self._own, name):
            return getattr(self._own, name)
        default = inspect.getattr_static(self._protocol, name)
        return default.__get__(self) if hasattr(default, "__get__") else default
