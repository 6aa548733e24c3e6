"""The space of a tuning: parameters with their ranges or choices, and the values to try next.

::

    [search]
    contact_model.lead = { from = 0.0, to = 1.0 }
    contact_model.window_s = { from = 0.02, to = 0.2, scale = "log" }
    device.substeps = { from = 1, to = 8 }             # whole numbers, as the parameter is one
    wave.missing = ["zero", "hold"]

Values are proposed by optuna's tree-structured Parzen estimator (Bergstra, Bardenet, Bengio, Kegl 2011), which handles
constraints. Its proposals depend only on the seed and the earlier trials, so a search can continue from its journal.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.study.goal import Worth
from hapnet.ext.study.spec import LINK, Values, entries, known, number
from hapnet.param_values import check_allowed
from hapnet.params import Params

DIGITS = 4
"""Significant digits of the numbers that are tried, so that the values found are easy to read and type."""

_PLAIN = Params()
_FIELDS = {name: (value, field) for name, value, field in _PLAIN.leaves()}
_RANGE = ("from", "to", "scale")
_NAMES = [name for name in _FIELDS if not name.startswith(f"{LINK}.")]
_LARGE = 1e300


@dataclass(frozen=True)
class Searched:
    """A parameter that is searched: between `low` and `high`, or among `choices`."""

    name: str
    default: Any
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    choices: tuple[Any, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether it is a whole number."""
        return not self.choices and isinstance(self.low, int)

    def __contains__(self, value: Any) -> bool:
        if self.choices:
            return value in self.choices
        return number(value) and self.low <= value <= self.high

    def __str__(self) -> str:
        if self.choices:
            return " | ".join(json.dumps(one) if not isinstance(one, str) else one for one in self.choices)
        return f"{self.low:g} to {self.high:g}{', log' if self.log else ''}"

    def tried(self, value: Any) -> Any:
        """The value to try for a proposed value: with few digits, and in the range."""
        if self.choices:
            return self.choices[value]
        return value if self.whole else min(max(float(f"{value:.{DIGITS}g}"), self.low), self.high)

    def plain(self, value: Any) -> Any:
        """The inverse of `tried`: the sampler's form of a value."""
        return self.choices.index(value) if self.choices else value


def searched(table: object) -> tuple[Searched, ...]:
    """The parameters that [search] lists. Raises InvalidParameter."""
    if not isinstance(table, Mapping) or not table:
        raise InvalidParameter("search", table, "a table, [search], of parameters and their ranges or choices")
    return tuple(_searched(name, given) for name, given in entries(table))


def need_library() -> None:
    """Raise MissingLibrary if the sampler's library is not installed."""
    if find_spec("optuna") is None:
        raise MissingLibrary("hapnet tune", "optuna", "tune")


def propose(
    space: Sequence[Searched], earlier: Sequence[tuple[Values, Worth]], count: int, seed: Sequence[int], random: int
) -> list[Values]:
    """`count` sets of values to try next.

    earlier : the earlier trials' values and worths. seed : different for each call. random : the number of random
        trials at the start.
    """
    import optuna
    from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    kinds: dict[str, BaseDistribution] = {}
    for one in space:
        if one.choices:
            kinds[one.name] = CategoricalDistribution(range(len(one.choices)))
        elif one.whole:
            kinds[one.name] = IntDistribution(int(one.low), int(one.high), log=one.log)
        else:
            kinds[one.name] = FloatDistribution(one.low, one.high, log=one.log)
    sampler = optuna.samplers.TPESampler(
        seed=int(np.random.SeedSequence(seed).generate_state(1)[0]), n_startup_trials=random, multivariate=True
    )
    study = optuna.create_study(sampler=sampler)
    study.add_trials(
        [
            optuna.trial.create_trial(
                params={one.name: one.plain(values[one.name]) for one in space},
                distributions=kinds,
                value=min(verdict.objective, _LARGE),
                constraints={"excess": verdict.excess},
            )
            for values, verdict in earlier
        ]
    )
    proposed = [study.ask(kinds).params for _ in range(count)]
    return [{one.name: one.tried(params[one.name]) for one in space} for params in proposed]


def _searched(name: str, given: Any) -> Searched:
    known("parameter", name, _NAMES, "a parameter of --show-params, but not the link")
    default, field = _FIELDS[name]
    if isinstance(given, list):
        values = [_PLAIN.typed({name: value})[name] for value in given]
        if len(values) < 2 or len({json.dumps(value) for value in values}) < len(values):
            raise InvalidParameter(name, given, "a list of several different values")
        for value in values:
            check_allowed(name, value, field.metadata["allowed"])
        return Searched(name, default, choices=tuple(values))
    if not isinstance(given, Mapping):
        raise InvalidParameter(name, given, "a range such as {from = 0.1, to = 10, scale = 'log'}, or a list of values")
    for word in given:
        known(name, word, _RANGE, "from, to and scale")
    if isinstance(default, bool | str):
        raise InvalidParameter(name, dict(given), "a list: these values have no range")
    low: Any
    high: Any
    low, high, scale = given.get("from"), given.get("to"), given.get("scale", "linear")
    if not number(low) or not number(high) or not low < high:
        raise InvalidParameter(name, dict(given), "a range {from = A, to = B} with A below B")
    if scale not in ("linear", "log"):
        raise InvalidParameter(f"scale of {name}", scale, "linear, or log")
    if scale == "log" and low <= 0:
        raise InvalidParameter(name, dict(given), "from and to above 0 on a log scale")
    ends = [_PLAIN.typed({name: end})[name] for end in (low, high)]
    for end in ends:
        check_allowed(name, end, field.metadata["allowed"])
    whole = isinstance(default, int)
    low, high = ends if whole else (float(low), float(high))
    return Searched(name, default, low, high, scale == "log")
