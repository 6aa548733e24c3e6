"""The hands of a world with several: each in its colour and with its name, in the 3-D part and in the panel.

A hand whose device has left is a ghost: it is pale, where it was. A seat that nobody has taken yet is not drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import viser

from hapnet.checks import Array
from hapnet.ext.page.bodies import Bodies
from hapnet.ext.page.history import Snapshot
from hapnet.plant.worlds.picture import FREE, HERE, LEFT, SeenHand

Color = tuple[int, int, int]

COLORS: tuple[Color, ...] = (
    (234, 88, 12), (22, 163, 74), (147, 51, 234), (14, 165, 233),
    (219, 39, 119), (202, 138, 4), (13, 148, 136), (100, 65, 45),
)  # fmt: skip
"""Of the hands, in the order of their seats; after the last the first one comes again."""

_ABOVE, _LINE = 1.1, 0.5  # of the names above a hand, in scene units

PALE = 0.25
"""Opacity of a ghost."""


class ShownHand(NamedTuple):
    """A hand as the page shows it. name : given with the page's address, or that of its seat."""

    name: str
    color: Color
    state: str
    body: int


def hands_of(snapshot: Snapshot) -> list[ShownHand]:
    """The hands that the world reports; none of a world with one hand, or if they cannot be read."""
    status = snapshot.world_status
    listed = () if status is None else status.about.get("hands", ())
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        return []
    found = [SeenHand(*one) for one in listed if isinstance(one, Sequence) and len(one) == len(SeenHand._fields)]
    return [
        ShownHand(str(snapshot.names.get(hand.name, hand.name)), COLORS[number % len(COLORS)], hand.state, hand.body)
        for number, hand in enumerate(found)
        if isinstance(hand.name, str) and type(hand.body) is int
    ]


class HandMarks:
    """Draws the others' hands: paints the `bodies` that they hold, and writes their names. up : where up is."""

    def __init__(self, scene: viser.SceneApi, bodies: Bodies, unit: float, up: Array) -> None:
        self._scene, self._bodies, self._unit, self._up = scene, bodies, unit, up
        self._shown: list[ShownHand] = []
        self._labels: dict[int, viser.LabelHandle] = {}

    def update(self, snapshot: Snapshot) -> ShownHand | None:
        """Show the newest states and places. Returns the hand of the page itself; None: the world has one hand."""
        hands = hands_of(snapshot)
        if hands != self._shown:
            self._shown = hands
            for hand in hands:
                self._mark(hand)
        poses = () if snapshot.scene is None else snapshot.scene.bodies()
        for line, (body, label) in enumerate(self._labels.items()):
            if body < len(poses):  # hands may be at the same place, as they are at their start
                label.position = self._unit * poses[body][:3] + (_ABOVE + _LINE * line) * self._up
        return next((hand for hand in hands if hand.body < 0), None)

    def _mark(self, hand: ShownHand) -> None:
        if hand.body < 0:
            return
        self._bodies.paint(hand.body, hand.color, {HERE: 1.0, LEFT: PALE}.get(hand.state, 0.0))
        if hand.body not in self._labels:
            self._labels[hand.body] = self._scene.add_label(
                f"/hand_{hand.body}", "", anchor="bottom-center", font_screen_scale=0.85
            )
        label = self._labels[hand.body]
        label.text = f" {hand.name} (left) " if hand.state == LEFT else f" {hand.name} "
        label.visible = hand.state in (HERE, LEFT)


def in_words(snapshot: Snapshot) -> list[tuple[str, Color]]:
    """The hands that have come, in words, each with its colour."""
    words = {HERE: "", LEFT: ", left"}
    return [
        (f"{hand.name}, you" if hand.body < 0 else hand.name + words.get(hand.state, ""), hand.color)
        for hand in hands_of(snapshot)
        if hand.state != FREE or hand.body < 0
    ]
