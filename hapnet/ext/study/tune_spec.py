"""The specification of a tuning: a TOML file with the searched values, the goal, and the cases to tune and to score on.

::

    [tune]
    objective = { force_error_percent = 1.0, free_rms_mm = 10.0 }
    constraints = ["passive", "stiffness_percent >= 90 in 75 %"]
    trials = 64                                # sets of values that are tried; the defaults are the first
    generation = 8                             # so many are chosen at once, whatever the number of workers
    seed = 0                                   # of the search

    [search]                                   # see hapnet.ext.study.search_space
    contact_model.lead = { from = 0.0, to = 1.0 }

    [fixed]                                    # fixed, and what varies from case to case, as in a sweep
    duration_s = 6
    [vary]
    link = ["lan", "4g"]
    seed = "0:2"

    [score]                                    # as [vary]: other links, hands or seeds, to score what was found
    link = ["wifi", "4g"]
    seed = "100:104"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.ext.study.goal import PASSIVE, Goal, goal_of
from hapnet.ext.study.search_space import Searched, searched
from hapnet.ext.study.spec import LINK, Case, Spec, Values, flat_of, known, link_words, profile, table_of

_TABLES = ("tune", "search", "fixed", "vary", "score")
_WHOLE = {"trials": (64, 1, 100_000), "generation": (8, 1, 1000), "seed": (0, 0, 2**32 - 1)}


@dataclass(frozen=True)
class TuneSpec:
    """The specification of a tuning.

    tuning, scoring : the cases of each part, without the searched parameters.
    trials : number of sets of values to try. generation : number of sets chosen at once. seed : of the search.
    """

    name: str
    space: tuple[Searched, ...]
    goal: Goal
    tuning: Spec
    scoring: Spec
    trials: int
    generation: int
    seed: int

    @classmethod
    def read(cls, file: Path, assignments: Mapping[str, object] | None = None) -> TuneSpec:
        """The spec in `file`; `assignments` override its fixed values.

        Raises InvalidParameter: the file cannot be read, an entry is not allowed, or a case is in both parts.
        """
        return cls.of_tables(file.stem, table_of(file), assignments)

    @classmethod
    def of_tables(cls, name: str, table: Values, assignments: Mapping[str, object] | None = None) -> TuneSpec:
        """The spec in a file's tables; raises as `read` does."""
        for word in table:
            known("table", word, _TABLES, ", ".join(f"[{name}]" for name in _TABLES))
        tune = table.get("tune")
        if not isinstance(tune, Mapping):
            raise InvalidParameter("tune", tune, "a table, [tune], with an objective")
        for word in tune:
            known("tune", word, ("objective", "constraints", *_WHOLE), f"objective, constraints, {', '.join(_WHOLE)}")
        tuning, scoring = (Spec.of(name, table, assignments, section) for section in ("vary", "score"))
        spec = cls(
            name,
            searched(table.get("search")),
            goal_of(tune.get("objective"), tune.get("constraints", [PASSIVE])),
            tuning,
            scoring,
            **{word: _whole(word, tune.get(word, default), low, high) for word, (default, low, high) in _WHOLE.items()},
        )
        for one in spec.space:
            if one.name in (*tuning.fixed, *tuning.varied, *scoring.varied):
                raise InvalidParameter(one.name, str(one), "either under [search] or under another table")
        always = set.intersection(*(set(axes) for axes in tuning.products))
        for axes in scoring.products:
            if missing := sorted(always - set(axes)):
                raise InvalidParameter("score", list(axes), f"all that varies under [vary]: {', '.join(missing)} too")
        spec._keep_apart()
        return spec

    @property
    def defaults(self) -> Values:
        """The default values of the searched parameters."""
        return {one.name: one.default for one in self.space}

    def whole(self, values: Values) -> Spec:
        """All cases with these values of the searched parameters in one spec, so that their keys have the same form."""
        own = {name: [value] for name, value in values.items()}
        products = tuple({**own, **axes} for axes in (*self.tuning.products, *self.scoring.products))
        return replace(self.tuning, products=products)

    def tuning_cases(self, values: Values) -> list[Case]:
        """The cases to tune on, with these values."""
        return self.whole(values).cases(slice(len(self.tuning.products)))

    def scoring_cases(self, values: Values) -> list[Case]:
        """The cases to score on, with these values."""
        return self.whole(values).cases(slice(len(self.tuning.products), None))

    def _keep_apart(self) -> None:
        """Raise InvalidParameter if a scoring case has the link, hand and seed of a tuning case."""
        tuned = {_circumstances(self.tuning, case) for case in self.tuning.cases()}
        for case in self.scoring.cases():
            if _circumstances(self.scoring, case) in tuned:
                every = flat_of(self.scoring.fixed, case.values)
                link = link_words(every["link.up"], every["link.down"])
                words = f"link {link}, operator {every['operator']}, seed {case.seed}"
                raise InvalidParameter("score", words, "a link, hand or seed that is not tuned on")


def _circumstances(spec: Spec, case: Case) -> tuple[Any, ...]:
    """Link, hand and seed of a case, in a form in which equal links are equal, however they are written."""
    every = flat_of(spec.fixed, case.values)
    every |= {name: profile(name, every[name]) for name in ("link.up", "link.down")}
    hand = [name for name in every if name == "operator" or name.startswith((f"{LINK}.", "operator_model."))]
    return case.seed, *(every[name] for name in hand)


def _whole(name: str, value: object, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise InvalidParameter(name, value, f"a whole number, {low} to {high}")
    return value
