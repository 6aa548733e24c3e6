"""The search of a tuning: which cases are run next, and which values are the best.

All that is known is in the journal, and what is tried next depends on nothing else but the spec. So a search that was
stopped is repeated from its beginning; it finds every result there, until it is where it stopped.

Optuna's own storage cannot do this: it fixes a trial's value when the trial ends, but a later trial may change what
earlier ones are worth (`judge`). It knows no cases either, so there would be two files that a crash can set apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hapnet.ext.metrics.measured import value_of
from hapnet.ext.study.case import Measures
from hapnet.ext.study.goal import Worth
from hapnet.ext.study.journal import Journal, JournalRow
from hapnet.ext.study.search_space import propose
from hapnet.ext.study.spec import Case, Values
from hapnet.ext.study.tune_spec import TuneSpec


@dataclass(frozen=True)
class Trial:
    """Values of what is searched, and the cases that were run with them."""

    values: Values
    rows: tuple[JournalRow, ...]

    @property
    def measures(self) -> list[Measures]:
        """Of the cases, empty for those that failed."""
        return [row.measures for row in self.rows]

    @property
    def failed(self) -> int:
        """How many cases failed."""
        return sum(row.error is not None for row in self.rows)


class Scores(NamedTuple):
    """The defaults and the values that were found, on the same cases; `found`: None if nothing was."""

    default: Trial
    found: Trial | None

    def verdicts(self, spec: TuneSpec) -> tuple[Worth, Worth | None]:
        """The worth of both on these cases."""
        known = [one for one in self if one is not None]
        reported = judge(spec, known)
        return reported[0], reported[1] if self.found is not None else None


class Search:
    """Runs through the generations of `spec`.

    Attributes
    ----------
    trials : those that were run so far, in their order. defaults : on the cases to tune and to score on.
    """

    def __init__(self, spec: TuneSpec, journal: Journal) -> None:
        self.spec: TuneSpec = spec
        self._journal = journal
        self.trials: list[Trial] = []
        self.defaults: tuple[Trial, Trial] | None = None
        self._score: Trial | None = None

    def rounds(self) -> Iterator[None]:
        """At each step the journal's cases without a result must be run before the next step."""
        spec, defaults = self.spec, self.spec.defaults
        tuned, scored = base(spec)
        self._journal.add([*tuned, *scored])
        yield
        self.defaults = self._trial(defaults, tuned), self._trial(defaults, scored)
        for number, start in enumerate(range(0, spec.trials, spec.generation)):
            size = min(spec.generation, spec.trials - start)
            known = [defaults] if number == 0 and _default_is_tried(spec) else []
            earlier = list(zip([one.values for one in self.trials], self.verdicts(), strict=True))
            fresh = propose(spec.space, earlier, size - len(known), (spec.seed, number), 2 * spec.generation)
            generation = [(values, spec.tuning_cases(values)) for values in (*known, *fresh)]
            for _, cases in generation:
                self._journal.add(cases)
            yield
            self.trials += [self._trial(values, cases) for values, cases in generation]
        if (best := self.best) is not None:
            cases = spec.scoring_cases(self.trials[best].values)
            self._journal.add(cases)
            yield
            self._score = self._trial(self.trials[best].values, cases)

    def verdicts(self) -> list[Worth]:
        """Return the worth of each trial, by all that is known by now."""
        assert self.defaults is not None
        return judge(self.spec, [*self.trials, self.defaults[0]])[:-1]

    @property
    def best(self) -> int | None:
        """The number of the best trial that breaks no constraint, the first of equal ones; None: all break one."""
        allowed = [(verdict.objective, i) for i, verdict in enumerate(self.verdicts()) if verdict.allowed]
        return min(allowed)[1] if allowed else None

    @property
    def unmeasured(self) -> list[str]:
        """The metrics of the goal that have a value in no case to tune on: it does not depend on them."""
        tuned = [*self.trials, *(self.defaults or ())[:1]]
        values = [measures for trial in tuned for measures in trial.measures]
        return [name for name in self.spec.goal.metrics if all(value_of(one, name) is None for one in values)]

    @property
    def scores(self) -> tuple[Scores, Scores] | None:
        """On the cases to tune and to score on, when all is done."""
        if self.defaults is None:
            return None
        found = None if self.best is None else self.trials[self.best]
        return Scores(self.defaults[0], found), Scores(self.defaults[1], self._score)

    def _trial(self, values: Values, cases: Sequence[Case]) -> Trial:
        return Trial(values, tuple(self._journal.find([case.key for case in cases])))


def base(spec: TuneSpec) -> tuple[list[Case], list[Case]]:
    """The cases with the default values: to tune, and to score on. They are in every journal of this spec."""
    return spec.tuning_cases(spec.defaults), spec.scoring_cases(spec.defaults)


def most_cases(spec: TuneSpec) -> int:
    """The largest number of cases that a search may need."""
    tuned, scored = (len(cases) for cases in base(spec))
    return (spec.trials + (not _default_is_tried(spec))) * tuned + 2 * scored


def _default_is_tried(spec: TuneSpec) -> bool:
    """Whether the defaults are the first trial. They may be outside of the ranges, such as a 0 for "by a rule"."""
    return all(one.default in one for one in spec.space)


def judge(spec: TuneSpec, trials: Sequence[Trial]) -> list[Worth]:
    """Return the worth of trials over the same cases; each shows which cases have a value of a metric."""
    measured = {
        (metric, place)
        for trial in trials
        for place, measures in enumerate(trial.measures)
        for metric in spec.goal.metrics
        if value_of(measures, metric) is not None
    }
    return [spec.goal.judge(trial.measures, measured, trial.failed) for trial in trials]
