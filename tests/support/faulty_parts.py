"""Files of a user whose device, law or world has a known fault, as text."""

DRIVERS = """
import math, time

from hapnet import HapnetError, Driver
from hapnet.devices import DeviceSilent

class Good(Driver):
    '''100 g on a rail, which a hand moves about 30 mm.'''
    force_limit, resolution = 3.0, 0.0

    def __init__(self, dof):
        self.dof, self.x, self.v, self.force, self.begun, self.at = dof, 0.0, 0.0, 0.0, None, time.monotonic()

    def begin(self):
        self.begun = time.monotonic()

    def begun_for(self, seconds):
        return self.begun is not None and time.monotonic() - self.begun > seconds

    def read(self):
        now = time.monotonic()
        dt, self.at = min(now - self.at, 0.02), now
        for _ in range(4 * (self.begun is not None)):
            self.v += dt / 4 * (self.force + 60.0 * (0.03 + 0.01 * math.sin(3 * now) - self.x) - 4.0 * self.v) / 0.1
            self.x += dt / 4 * self.v
        return (self.x,), (self.v,)

    def apply(self, force):
        self.force = force[0]

class Coarse(Good):
    resolution = 0.01
    def read(self):
        (x,), velocity = super().read()
        return (round(x / 0.01) * 0.01,), velocity

class Raises(Good):
    def read(self):
        if self.begun_for(1.0):
            raise RuntimeError("the bus says no")
        return super().read()

class Hangs(Good):
    hung = False
    def read(self):
        if self.begun_for(1.0) and not self.hung:
            self.hung = True
            time.sleep(4.0)
        return super().read()

class Stalls(Good):
    reads = 0
    def read(self):
        self.reads += self.begun_for(1.0)
        if self.reads % 50 == 49:
            time.sleep(0.05)
        return super().read()

class Flips(Good):
    def apply(self, force):
        super().apply((-force[0],) if self.begun_for(2.0) else force)

class Mute(Good):
    def read(self):
        raise DeviceSilent("no answer")

class Silent(Good):
    '''Answers once, when it is opened.'''
    opened = 0
    def read(self):
        self.opened += 1
        if self.opened == 1:
            return super().read()
        raise DeviceSilent("no answer")

class Gone(Silent):
    '''Its port goes later.'''
    def read(self):
        if self.opened and time.monotonic() - self.at > 4.0:
            raise HapnetError("the port is gone")
        return super().read()

class Unplugged(Good):
    def read(self):
        if self.begun_for(1.0):
            raise HapnetError("the port is gone")
        return super().read()

class Steps(Good):
    '''Measures 50 times a second, and repeats its reading meanwhile.'''
    greatest_speed, old, since = 0.5, ((0.0,), (0.0,)), 0.0
    def read(self):
        new = super().read()
        if self.at - self.since > 0.02:
            self.old, self.since = new, self.at
        return self.old
"""

LAWS = """
from dataclasses import replace
from hapnet.ext.laws.zoh import LAW
Claims = replace(LAW, name="claims", covers=lambda params, tuning, virtual: True, compiled=None)
"""

WORLDS = """
import math, time

class Wall:
    dof, stored_J = 1, 0.0
    def __init__(self):
        self.steps = 0
    def step(self, dt, position, velocity):
        self.steps += 1
        return (0.0,)

class Raises(Wall):
    def step(self, dt, position, velocity):
        if self.steps > 40:
            raise ArithmeticError("no strength left")
        return super().step(dt, position, velocity)

class Endless(Wall):
    '''Its stored energy is no number at the end.'''
    def step(self, dt, position, velocity):
        self.stored_J = math.nan if self.steps > 40 else 0.0
        return super().step(dt, position, velocity)
"""
