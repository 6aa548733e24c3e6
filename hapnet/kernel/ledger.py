"""The account of one side: the methods of `hapnet.control.ledger.Ledger` itself, compiled as they stand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hapnet.control.ledger import Ledger as Reference
from hapnet.control.ledger import _added as plain_added
from hapnet.kernel.jit import shared
from hapnet.kernel.records import Record


class Ledger(Record):
    """The attributes of `hapnet.control.ledger.Ledger`."""

    bound: float
    work: float
    credited: float
    sent: float
    margin: float
    margin_min: float
    slack: float
    slack_min: float
    stored: float
    reservoir: float
    _carry: float
    _sent_carry: float
    _credited_carry: float


_added = shared(plain_added)
credit: Callable[..., Any] = shared(Reference.credit, _added=_added)
send: Callable[..., Any] = shared(Reference.send, _added=_added)
put_in: Callable[..., Any] = shared(Reference.put_in)
observe: Callable[..., Any] = shared(Reference.observe)
