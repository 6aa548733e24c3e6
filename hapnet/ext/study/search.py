"""The search of a tuning: chooses the cases that are run next, and the best values.

The next values depend only on the journal and the spec. So a search that was stopped is repeated from its beginning,
and finds every result in the journal until it reaches the point at which it was stopped.

Optuna's own storage cannot do this: it fixes a trial's value when the trial ends, but a later trial may change the
worth of earlier trials (`judge`). It has no cases either, so a crash could leave two files that contradict each other.
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
    """Values of the searched parameters, and the cases that were run with them."""

    values: Values
    rows: tuple[JournalRow, ...]

    @property
    def measures(self) -> list[Measures]:
        """The measures of the cases, empty for failed cases."""
        return [row.measures for row in self.rows]

    @property
    def failed(self) -> int:
        """The number of failed cases."""
        return sum(row.error is not None for row in self.rows)


class Scores(NamedTuple):
    """The defaults and the values found, on the same cases; `found`: None if no allowed values were found."""

    default: Trial
    found: Trial | None

    def verdicts(self, spec: TuneSpec) -> tuple[Worth, Worth | None]:
        """The worth of both on these cases."""
        known = [trial for trial in self if trial is not None]
        worths = judge(spec, known)
        return worths[0], worths[1] if self.found is not None else None


class Search:
    """Runs through the generations of `spec`.

    Attributes
    ----------
    trials : the trials so far, in order. defaults : the trials with default values on the cases to tune and to score.
    """

    def __init__(self, spec: TuneSpec, journal: Journal) -> None:
        self.spec: TuneSpec = spec
        self._journal = journal
        self.trials: list[Trial] = []
        self.defaults: tuple[Trial, Trial] | None = None
        self._score: Trial | None = None

    def rounds(self) -> Iterator[None]:
        """Yield after each addition of cases to the journal; they must be run before the next step."""
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
        """Return the worth of each trial, from all results so far."""
        assert self.defaults is not None
        return judge(self.spec, [*self.trials, self.defaults[0]])[:-1]

    @property
    def best(self) -> int | None:
        """The number of the best trial that breaks no constraint, the first among equals; None: all break one."""
        allowed = [(verdict.objective, i) for i, verdict in enumerate(self.verdicts()) if verdict.allowed]
        return min(allowed)[1] if allowed else None

    @property
    def unmeasured(self) -> list[str]:
        """The metrics of the goal without a value in any tuning case, which so have no influence."""
        tuned = [*self.trials, *(self.defaults or ())[:1]]
        values = [measures for trial in tuned for measures in trial.measures]
        return [name for name in self.spec.goal.metrics if all(value_of(one, name) is None for one in values)]

    @property
    def scores(self) -> tuple[Scores, Scores] | None:
        """The scores on the cases to tune and to score on, at the end; None before the first results."""
        if self.defaults is None:
            return None
        found = None if self.best is None else self.trials[self.best]
        return Scores(self.defaults[0], found), Scores(self.defaults[1], self._score)

    def _trial(self, values: Values, cases: Sequence[Case]) -> Trial:
        return Trial(values, tuple(self._journal.find([case.key for case in cases])))


def base(spec: TuneSpec) -> tuple[list[Case], list[Case]]:
    """The cases with the default values, to tune and to score on, which are in every journal of this spec."""
    return spec.tuning_cases(spec.defaults), spec.scoring_cases(spec.defaults)


def most_cases(spec: TuneSpec) -> int:
    """The largest number of cases that a search may need."""
    tuned, scored = (len(cases) for cases in base(spec))
    return (spec.trials + (not _default_is_tried(spec))) * tuned + 2 * scored


def _default_is_tried(spec: TuneSpec) -> bool:
    """Whether the defaults are the first trial. They may be outside of the ranges, such as a 0 for "by a rule"."""
    return all(one.default in one for one in spec.space)


def judge(spec: TuneSpec, trials: Sequence[Trial]) -> list[Worth]:
    """Return the worth of trials over the same cases; all trials together show which cases have a value of a metric."""
    measured = {
        (metric, place)
        for trial in trials
        for place, measures in enumerate(trial.measures)
        for metric in spec.goal.metrics
        if value_of(measures, metric) is not None
    }
    return [spec.goal.judge(trial.measures, measured, trial.failed) for trial in trials]
