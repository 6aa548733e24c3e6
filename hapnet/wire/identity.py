"""The identity of a side when it pairs, and the rules by which two sides fit."""

from __future__ import annotations

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.units import METRES
from hapnet.wire.messages import Identity, Welcome, decode, encode

COUPLING = "coupling"
"""Entry of `about`: the coupling that a side runs. Both must run the same."""
UNITS = "units"
"""Entry of `about`: the units of a side's axes, as `hapnet.units` has them; absent: metres. Both must have the same."""
SHARED = "shared."
"""The prefix of entries of `about` that are numbers of the coupling and must be equal on both sides."""

RESERVOIR = "reservoir_J"
"""Entry of `about`: the energy in a side's reservoir when it starts, unless it takes the place of another side [J]."""

SAMPLED, MOST_SAMPLED = "sampled", 1000
"""Entry of `about`: nothing overtakes a message of the stream whose number is a multiple of it; from 1 to this."""

ROBOT = "robot"
"""Entry of a world's `about`: true if the device leads a robot there; else absent."""

EARLIER = "earlier"
"""Entry of a welcome's `about`: the number of other incarnations that were its sender's peer before; absent if 0."""


def misfit(me: Identity, peer: Identity) -> str:
    """Return why `peer` and this side cannot be a pair; empty if they can."""
    if peer.role == me.role:
        return f"both sides are a {me.role}: {peer.name} and {me.name}"
    if peer.dof != me.dof:
        return f"{peer.name} has {peer.dof} degrees of freedom, {me.name} has {me.dof}"
    mine, theirs = me.about.get(COUPLING), peer.about.get(COUPLING)
    if mine is not None and theirs is not None and mine != theirs:
        return f"{peer.name} runs the coupling {theirs}, {me.name} runs {mine}"
    units = peer.about.get(UNITS, METRES), me.about.get(UNITS, METRES)
    if units[0] != units[1]:
        return f"{peer.name} has axes in {units[0]}, {me.name} in {units[1]}: both must have the same"
    for key, value in me.about.items():
        if key.startswith(SHARED) and key in peer.about and value != peer.about[key]:
            name = key.removeprefix(SHARED)
            return f"{peer.name} has {name} {peer.about[key]}, {me.name} has {value}: both must have the same"
    return ""


def check_identity(identity: Identity) -> None:
    """Check that a side can read its own hello and welcome, with the largest numbers.

    Raises InvalidParameter: it cannot.
    """
    try:
        me = identity
        about = {**me.about, EARLIER: 2**63}
        data = encode(Welcome(me.incarnation, 2**64 - 1, 2**64 - 1, me.role, me.dof, me.name, about))
        if not me.name:
            raise BadMessage("range", "name is empty")
        decode(data)
    except (BadMessage, TypeError, ValueError, OverflowError) as error:
        allowed = f"incarnation of 64 bits, not 0; role device or world; 1 to 64 dof; short texts and numbers ({error})"
        raise InvalidParameter("identity", identity, allowed) from None
