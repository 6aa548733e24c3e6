"""The hands of `hapnet.plant.natural_hands` as operators, `tests.support.natural_hands:NAME`."""

import numpy as np

from hapnet.plant.natural_hands import WALL_M as WALL_M, Strokes, Writing as Pen
from hapnet.plant.operator import Impedance


class InTheAir(Strokes):
    """Strokes that never touch the wall."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, np.random.default_rng(4101), touches=0.0, slides=0.0)


class Tapping(Strokes):
    """Half of the strokes end behind the wall."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, np.random.default_rng(4102), touches=0.5, slides=0.0)


class Mixed(Strokes):
    """Strokes, taps and slides."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, np.random.default_rng(4103))


class Writing(Pen):
    """A pen that writes on the wall."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, np.random.default_rng(4104))
