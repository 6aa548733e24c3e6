"""The couplings, by the names that a user gives them."""

from __future__ import annotations

from hapnet.params import Params


def ideal_stiffness(params: Params, wall: float) -> float:
    """What a hand at a wall of stiffness `wall` [N/m] would feel of the coupling's springs in series, at rest [N/m].

    For scalar stiffnesses. The device's spring K sees the proxy move back by K'/(K' + K_w) of the way into the wall.
    """
    K, K_world = params.device.stiffness, params.world.stiffness
    assert isinstance(K, float)
    assert isinstance(K_world, float)
    return K * wall / (K_world + wall)
