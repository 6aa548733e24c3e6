"""Builds a side's deadband from the parameters."""

from __future__ import annotations

from hapnet.control.deadband import MAX_S, MAX_WAVE_S, Deadband
from hapnet.couplings.registry import coupling
from hapnet.params import Params
from hapnet.wire.messages import Role, Wave

SENT_A_SILENCE = 5
"""A deadband sends at least this many samples in the time after which a peer counts as silent."""


def deadband(params: Params, role: Role) -> Deadband | None:
    """The deadband that decides which samples this side sends; None: it sends all."""
    if params.wire.deadband == 0.0:
        return None
    spec = coupling(params.coupling)
    sends = spec.sends(role, params)
    silence_s = min(params.device.silence_after_s, params.world.silence_after_s)
    return Deadband(
        params.wire.deadband,
        longest_s=min(MAX_WAVE_S if sends is Wave else MAX_S, silence_s / SENT_A_SILENCE),
        port="position" if role == "device" else "force",
    )
