"""The hands of one world: the setup of each one's pair, and the steps that all make together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from hapnet.assembly.build import Setup
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import WATCH, Edge, Graph, about
from hapnet.ext.many.joint import JointSeat, Push, seat_of
from hapnet.ext.many.models import seats_in_model
from hapnet.ext.many.reservoirs import Reservoirs, is_heard
from hapnet.ext.many.shared import Seat
from hapnet.ext.many.shares import checked, prepared
from hapnet.ext.robots.follower import Robot
from hapnet.ext.robots.robot_scene import RobotScene
from hapnet.param_sources import RULE
from hapnet.params import Params
from hapnet.plant.worlds.protocol import World
from hapnet.side.endpoint import NANO
from hapnet.side.world import WorldSide
from hapnet.wire.session import Session

Change = Callable[[Params], Params]
"""Changes the parameters of every pair, after those of the graph."""

ADMISSION: Mapping[str, object] = {"wire.admission_W": 1.0, "wire.admission_burst_J": 0.1}
"""The admission of a world with several hands, unless it is set. A device that lies about its energy moves what all
hold: a block of 0.2 kg at up to 1.6 m/s with the admission for one hand, at 0.75 m/s with this."""


def graph_setups(graph: Graph, change: Change) -> dict[str, Setup]:
    """The setups of all edges, by their names. Raises InvalidParameter: they do not fit each other."""
    found: dict[str, Setup] = {}
    for node in graph.nodes:
        edges = graph.led_to(node)
        found |= zip([edge.name for edge in edges], world_setups(graph, edges, change), strict=True)
    return checked(graph, found)


def world_setups(graph: Graph, edges: Sequence[Edge], change: Change) -> list[Setup]:
    """The setups of the edges of one world. Raises InvalidParameter: the world has no room for its hands."""
    made: list[Setup] = []
    scenes: list[World] = []
    for number, edge in enumerate(edges):
        with about(f"edges.{edge.name}"):
            params = change(graph.pair(edge))
            if len(edges) > 1:
                params = params.set({name: value for name, value in ADMISSION.items() if not params.asked(name)}, RULE)
            setup = prepared(graph, edge, params)
        if len(edges) > 1 or edge.at or edge.proxy:
            scenes = seats_in_model(setup, edges) if not number else scenes
            world = made[0].scene if made else setup.scene
            setup = replace(setup, scene=scenes[number] if scenes else _scene_of(edge, world, len(edges)))
        _give_rights(edge, setup.scene)
        if len(edges) > 1 and isinstance(setup.scene, RobotScene):
            _join_robot(edge, setup)
        made.append(setup)
    return made


def live_setups(graph: Graph, edges: Sequence[Edge], change: Change) -> list[Setup]:
    """As `world_setups`, for a world in real time. Raises InvalidParameter: its hands lead robots."""
    made = world_setups(graph, edges, change)
    require_live(made)
    return made


def require_live(setups: Sequence[Setup]) -> None:
    """Raise InvalidParameter: several hands of this world, with these setups, lead robots."""
    if len(setups) > 1 and setups[0].scene.robot:
        allowed = "none with several hands in real time: hapnet simulate --graph FILE runs it"
        raise InvalidParameter("follower.robot", setups[0].params.follower.robot, allowed)


def _give_rights(edge: Edge, scene: World) -> None:
    if edge.rights == WATCH:
        if not isinstance(scene, Seat):
            why = "a hand holds its proxy" if isinstance(scene, JointSeat) else "each hand has its walls for itself"
            why = "its hand leads a robot" if isinstance(scene, RobotScene) else why
            allowed = f"left out in the scene {scene.name}: {why}"
            raise InvalidParameter(f"edges.{edge.name}.rights", edge.rights, allowed)
        scene.may_touch = False


def _join_robot(edge: Edge, setup: Setup) -> None:
    """Let the robot of this edge touch the bodies together with others. Raises InvalidParameter: it cannot."""
    scene, robot = setup.scene, setup.params.follower
    if (seat := seat_of(scene)) is None:
        return
    assert isinstance(scene, RobotScene), "checked"
    if robot.motion_scale != robot.force_scale:
        allowed = f"{robot.motion_scale:g}, as follower.motion_scale, where several robots touch the bodies of a world"
        name = f"nodes.{edge.world}: follower.force_scale"
        raise InvalidParameter(name, robot.force_scale, f"{allowed}: one account has their energy")
    scene.is_joint = seat.has_robot = True


def warnings_of(setups: Iterable[Setup]) -> tuple[str, ...]:
    """The warnings of all these setups, each once."""
    return tuple(dict.fromkeys(line for setup in setups for line in setup.warnings))


def _scene_of(edge: Edge, world: World, hands: int) -> World:
    """The world for one of its hands. Raises InvalidParameter: the world has no room for it there."""
    if edge.proxy:
        why = f"the scene {world.name} is no MuJoCo model, whose bodies are proxies; leave `proxy` out"
        raise InvalidParameter(f"edges.{edge.name}.proxy", edge.proxy, "", why=why)
    if edge.at and len(edge.at) != world.dof:
        raise InvalidParameter(f"edges.{edge.name}.at", list(edge.at), f"{world.dof} lengths, one for each axis")
    try:
        scene = world.for_hand_at(edge.at or (0.0,) * world.dof)
        if scene is not None:
            scene.contacts.require_outside(scene.start)
    except InvalidParameter as error:
        raise error.renamed(f"edges.{edge.name}.at: {error.name}") from error
    if scene is None:
        allowed = (
            "one edge without `at`: walls, shared:block, and without robots MuJoCo's models, have room for several "
            "hands"
        )
        raise InvalidParameter(f"nodes.{edge.world}: scene {world.name}", f"{hands} edges", allowed)
    return scene


class JointSteps:
    """Solves the contacts of all hands before the hands' sides make their steps, and counts the step afterwards.

    sides : of one world, each with its session. Among walls, without bodies that they share, each hand is alone, and no
    contacts are left to solve. reservoirs : of their seats; one hand alone has its own.

    A hand whose device has left, or has been silent for `world.silence_after_s`, touches nothing until it is back. A
    robot stays where it is.
    """

    def __init__(self, sides: Sequence[tuple[WorldSide, Session]], reservoirs: Reservoirs | None = None) -> None:
        self._sides, self._reservoirs = sides, reservoirs
        self._seats = [(side, session, seat) for side, session in sides if (seat := seat_of(side.scene)) is not None]
        shared = self._seats[0][2].shared if self._seats else None
        self._shared = None if shared is None or len(shared.seats) == 1 else shared

    def begin(self, now_ns: int) -> None:
        """Solve the step that ends at `now_ns` for all hands whose control has started."""
        if self._reservoirs is not None:
            self._reservoirs.begin_step(now_ns, self._sides)
        if self._shared is None:
            return
        dt, moving = 0.0, dict[JointSeat, Vector | Push]()
        for side, session, seat in self._seats:
            seat.see(heard := is_heard(session, now_ns))
            if side.origin_ns is not None and not side.paused:
                dt = (now_ns - side.stepped.began_ns) * NANO
                if isinstance(side.mass, Robot) and side.servo is not None:
                    moving[seat] = Push(*side.mass.drive(dt, side.servo.force))
                    continue
                seat.is_here = seat.may_touch and heard
                side.mass.limit_energy(side.coupling.account)
                moving[seat] = side.coupling.set_position
        if moving:
            self._shared.begin_step(dt, moving)

    def end(self, now_ns: int) -> None:
        """Count the step in the world's accounts, after all sides have made it."""
        if self._shared is not None:
            self._shared.end_step()
        if self._reservoirs is not None:
            self._reservoirs.end_step(now_ns, self._sides)
