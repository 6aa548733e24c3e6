"""The needs of a scene with a tool on the device's side: its handle, the hand that holds it, and a driver that
turns.
"""

from __future__ import annotations

from hapnet.ext.tools.device import SimulatedHandle as SimulatedHandle
from hapnet.ext.tools.hand import TurningHand as TurningHand
from hapnet.ext.tools.posed import Posed as Posed
from hapnet.ext.tools.scene import seen_by_the_hand as seen_by_the_hand
