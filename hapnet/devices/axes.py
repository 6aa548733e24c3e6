"""Which of a device's axes the scene uses, and in which direction: ``xyz``, ``xz``, ``-y``."""

from __future__ import annotations

import re

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter

_ONE = re.compile(r"(-?)([xyz])")


class Axes:
    """The choice of axes `text` of a device with `native` axes, for a scene with `dof` of them.

    text : one letter for each axis of the scene, with a minus if its direction is reversed; empty: the first ones.

    Raises InvalidParameter: they do not fit.
    """

    def __init__(self, text: str, dof: int, native: int = 3) -> None:
        letters = "xyz"[:native]
        text = text or letters[:dof]
        chosen = _ONE.findall(text)
        names = [letter for _, letter in chosen]
        whole = "".join(map("".join, chosen)) == text
        if not whole or len(names) != dof or len(set(names)) != dof or not set(names) <= set(letters):
            allowed = f"{dof} of {letters}, one for each axis of the scene, such as {letters[:dof] or 'x'}"
            raise InvalidParameter("axes", text, f"{allowed}; a minus before one turns it round")
        self._native = native
        self._chosen = [(letters.index(letter), -1.0 if sign else 1.0) for sign, letter in chosen]

    def take(self, whole: Vector) -> Vector:
        """The scene's axes of a vector of the device."""
        return tuple([sign * whole[axis] for axis, sign in self._chosen])

    def spread(self, part: Vector) -> Vector:
        """The vector of the device whose chosen axes are `part`; the others are 0."""
        whole = [0.0] * self._native
        for (axis, sign), value in zip(self._chosen, part, strict=True):
            whole[axis] = sign * value
        return tuple(whole)
