"""The handshake's states and the effect of each input in them: one table, `TRANSITIONS`.

The table decides, and `hapnet.wire.handshake` acts. An input is an event, as far as it matters for pairing: the kind
of message, its sender and whether it fits. A row has the next state, the actions, and the reason if the message is
dropped. A peer cannot cause a combination of state and input without a row: it is an error of this side's own program
and raises `LocalProtocolError`. A peer's error is a row with a reason to drop, and becomes a `BadMessage`. (h11
likewise separates local and remote errors.)
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from hapnet.errors import LocalProtocolError


class PairingState(Enum):
    """The state of a side in finding and keeping its peer."""

    SEARCHING = "there is no peer; this side sends hellos"
    PAIRED = "there is a peer, and messages from it came lately"
    SILENT = "there is a peer, but no message from it came lately: another may take its place"
    LEFT = "this side has sent its bye"


class Input(Enum):
    """The inputs of the table.

    The candidate is the stranger that this side has answered. Only the candidate may become the peer next.
    """

    PEER_HEARD = "time: a message from the peer came lately"
    PEER_SILENT = "time: no message from the peer came lately"
    CLOSE = "this side ends"

    OWN = "a message of this side's own incarnation"
    RETIRED = "a hello, a welcome, energy or a stream's message of a retired incarnation"
    MISADDRESSED = "a welcome, a refusal or the peer's energy to another incarnation"
    OTHER_CANDIDATE = "a hello, a welcome or a refusal of a stranger, while another stranger is the candidate"

    HELLO_OF_PEER = "the peer's hello"
    HELLO = "a hello that fits"
    UNFIT_HELLO = "a hello that does not fit"
    UNPROVEN_HELLO = "a hello that fits, of a side that must prove first that it holds its key"
    UNPROVEN_UNFIT_HELLO = "the same, but it does not fit"
    FALSE_PROOF = "a hello, a welcome or a refusal without its sender's seal"
    FORGED_HELLO = "a hello in the peer's name that does not fit, although the peer fits"
    WELCOME_OF_PEER = "the peer's welcome"
    WELCOME = "a welcome that fits and answers a recent hello"
    STALE_WELCOME = "a welcome to a hello that this side never sent, or sent before the last change of its peer"
    UNFIT_WELCOME = "a welcome that answers a recent hello, but does not fit"
    REFUSAL_OF_PEER = "the peer's refusal"
    REFUSAL = "a stranger's refusal"
    BYE_OF_PEER = "the peer's bye"
    BYE_OF_RETIRED = "the bye of a retired incarnation"
    BYE = "a stranger's bye"
    DATA = "energy or a stream's message of a stranger"


class Action(Enum):
    """The actions of the handshake. Unless stated otherwise, an action concerns the sender of the message."""

    MAKE_CANDIDATE = "the sender is the candidate from now on"
    SEND_WELCOME = "answer with a welcome"
    ASK_PROOF = "answer with a hello to it, which only its welcome can answer; with a refusal if it has no key"
    REPORT_UNPROVEN = "report that the sender does not prove its identity"
    SEND_REFUSAL = "answer with a refusal and its reason, and report the mismatch"
    REFUSE_RETIRED = "answer with a refusal: a former peer never becomes the peer again"
    SEND_HELLO = "send a hello soon"
    PAIR = "the sender is the peer from now on; the former peer is retired, and refused"
    END_PAIR = "the peer is retired; send a hello soon"
    REPORT_REFUSAL = "report that a stranger refuses this side"
    REPORT_END_BY_REFUSAL = "report that the peer refused this side"
    REPORT_BYE = "report that the peer has left"


class Drop(Enum):
    """The reasons for dropping a message: the kind under which it is counted, and the text for people."""

    OWN = "own", "this side's own incarnation came back"
    RETIRED = "retired", "incarnation {sender:#x} was the peer once"
    MISADDRESSED = "addressee", "meant for incarnation {addressee:#x}"
    PEER_IS_HEARD = "rival", "incarnation {sender:#x} tries to replace a peer that is alive"
    OTHER_CANDIDATE = "rival", "incarnation {sender:#x} sends while another one is about to be the peer"
    FALSE_PROOF = "forged", "incarnation {sender:#x} does not prove that it holds the key that it offers"
    STALE_WELCOME = "stale", "welcome to hello {number}, which was before the last pairing, or was never sent"
    UNPAIRED = "unpaired", "incarnation {sender:#x} is not the peer yet"
    STRANGER = "stranger", "incarnation {sender:#x} is not the peer's"
    BYE_OF_RETIRED = "retired", "bye of {sender:#x}, which is not the peer any more"
    BYE_OF_STRANGER = "stranger", "bye of {sender:#x}, which is not the peer"


class Transition(NamedTuple):
    """A row: the next state, the actions, and why the message is dropped (None: it counts)."""

    state: PairingState
    actions: tuple[Action, ...] = ()
    drop: Drop | None = None


def _row(state: PairingState, *actions: Action, drop: Drop | None = None) -> Transition:
    return Transition(state, actions, drop)


def _in_any(state: PairingState) -> dict[Input, Transition]:
    """The rows that every state but the last has in common."""
    return {
        Input.CLOSE: _row(PairingState.LEFT),
        Input.OWN: _row(state, drop=Drop.OWN),
        Input.RETIRED: _row(state, Action.REFUSE_RETIRED, drop=Drop.RETIRED),
        Input.MISADDRESSED: _row(state, drop=Drop.MISADDRESSED),
        Input.UNFIT_HELLO: _row(state, Action.SEND_REFUSAL),
        Input.UNPROVEN_UNFIT_HELLO: _row(state, Action.ASK_PROOF),
        Input.BYE_OF_RETIRED: _row(state, drop=Drop.BYE_OF_RETIRED),
        Input.BYE: _row(state, drop=Drop.BYE_OF_STRANGER),
    }


def _with_peer(state: PairingState) -> dict[Input, Transition]:
    """The rows of a side with a peer, silent or not."""
    return _in_any(state) | {
        Input.PEER_HEARD: _row(PairingState.PAIRED),
        Input.PEER_SILENT: _row(PairingState.SILENT),
        Input.HELLO_OF_PEER: _row(state, Action.SEND_WELCOME),
        Input.FORGED_HELLO: _row(state),
        Input.WELCOME_OF_PEER: _row(state),
        Input.REFUSAL_OF_PEER: _row(PairingState.SEARCHING, Action.END_PAIR, Action.REPORT_END_BY_REFUSAL),
        Input.BYE_OF_PEER: _row(PairingState.SEARCHING, Action.END_PAIR, Action.REPORT_BYE),
    }


def _open_to_strangers(state: PairingState, no_peer: Drop) -> dict[Input, Transition]:
    """The rows for strangers while there is no peer, or it is silent."""
    return {
        Input.OTHER_CANDIDATE: _row(state, drop=Drop.OTHER_CANDIDATE),
        Input.HELLO: _row(state, Action.MAKE_CANDIDATE, Action.SEND_WELCOME, Action.SEND_HELLO),
        Input.UNPROVEN_HELLO: _row(state, Action.ASK_PROOF),
        Input.FALSE_PROOF: _row(state, Action.REPORT_UNPROVEN, drop=Drop.FALSE_PROOF),
        Input.WELCOME: _row(PairingState.PAIRED, Action.PAIR),
        Input.STALE_WELCOME: _row(state, Action.SEND_HELLO, drop=Drop.STALE_WELCOME),
        Input.UNFIT_WELCOME: _row(state, Action.MAKE_CANDIDATE, Action.SEND_REFUSAL),
        Input.REFUSAL: _row(state, Action.REPORT_REFUSAL),
        Input.DATA: _row(state, Action.SEND_HELLO, drop=no_peer),
    }


def _closed_to_strangers(state: PairingState) -> dict[Input, Transition]:
    """The rows for strangers while the peer is not silent: none can take its place."""
    rivals = _open_to_strangers(state, Drop.PEER_IS_HEARD)
    return dict.fromkeys(rivals, _row(state, drop=Drop.PEER_IS_HEARD))


TRANSITIONS: dict[PairingState, dict[Input, Transition]] = {
    PairingState.SEARCHING: _in_any(PairingState.SEARCHING) | _open_to_strangers(PairingState.SEARCHING, Drop.UNPAIRED),
    PairingState.PAIRED: _with_peer(PairingState.PAIRED) | _closed_to_strangers(PairingState.PAIRED),
    PairingState.SILENT: _with_peer(PairingState.SILENT) | _open_to_strangers(PairingState.SILENT, Drop.STRANGER),
    PairingState.LEFT: {},
}
"""The whole table. A peer cannot cause an input for which a state has no row."""


def transition(state: PairingState, happened: Input) -> Transition:
    """The row of `happened` in `state`.

    Raises LocalProtocolError: there is none: an error of this side's own program.
    """
    row = TRANSITIONS[state].get(happened)
    if row is None:
        raise LocalProtocolError(f"{happened.name} in state {state.name}; allowed: {_names(TRANSITIONS[state])}")
    return row


def _names(rows: dict[Input, Transition]) -> str:
    return ", ".join(happened.name for happened in rows) or "nothing any more"
