"""`hapnet.compare`: measures couplings over the same links, with the same hands and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

from hapnet.errors import InvalidParameter
from hapnet.ext.pictures.style import also_to
from hapnet.ext.study import compare as cases_of, tables
from hapnet.ext.study.case import kept, was_passive
from hapnet.ext.study.compare import LOCAL, ComparedRun, Group, Plan, RunMeasures
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.plans import BASE, plans
from hapnet.ext.study.run import Progress, journal_in, run_all
from hapnet.params import Params

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Comparison:
    """The result of a comparison.

    plan : of the comparison. outcomes : of each case, those of the local wall for each link. groups : medians of each
    coupling over each link, for all operators together (`Group.operator` is None) and, if there are several, for each.
    """

    plan: Plan
    outcomes: list[RunMeasures]
    groups: list[Group]

    @classmethod
    def of(cls, plan: Plan, journal: Journal) -> Comparison:
        """The comparison from a journal in which all cases of the plan were run.

        Raises InvalidParameter: all cases failed; the message has the first error.
        """
        outcomes = plan.outcomes(journal.rows())
        if all(one.error is not None for one in outcomes if one.case.variant != LOCAL):
            names = ", ".join(map(str, plan.couplings))
            raise InvalidParameter("--coupling", names, "", why=f"no case could run: {outcomes[0].error}")
        return cls(plan, outcomes, cases_of.groups(plan, outcomes))

    def __len__(self) -> int:
        """The number of runs; the local wall of a hand and a seed is one run, whatever the link."""
        return len(self.plan.spec.cases())

    def __repr__(self) -> str:
        return f"Comparison({len(self)} cases; {'; '.join(self.headline)})"

    @property
    def headline(self) -> list[str]:
        """A line for each coupling that was not passive in all cases, or a single line if all were passive."""
        return tables.headline(self.plan, self.groups)

    @property
    def broken(self) -> list[ComparedRun]:
        """The cases in which a coupling claims to be passive but was not."""
        return [one.case for one in self.outcomes if one.measures is not None and not kept(one.measures)]

    def rows(self) -> list[dict[str, Any]]:
        """A row for each case: its settings, whether it was ``passive``, every metric, and its ``error`` or None."""
        return [
            {
                **one.case.about,
                "passive": None if one.measures is None else was_passive(one.measures),
                **(one.measures or {}),
                "error": one.error,
            }
            for one in self.outcomes
        ]

    def medians(self) -> list[dict[str, Any]]:
        """A row for each of `groups`, with each metric's median, interval and quartiles, as in compare.csv."""
        return tables.as_rows(self.groups)

    def as_dict(self) -> dict[str, Any]:
        """The whole comparison, as in compare.json."""
        return tables.as_dict(self.plan, self.outcomes, self.groups)

    def plot(self, file: str | PathLike[str] | None = None) -> Figure:
        """The figure of force error and stiffness over the energy that came out; written to `file`, if given."""
        from hapnet.ext.study.figures import tradeoff

        return also_to(tradeoff(self.plan, self.outcomes), file)

    def _repr_html_(self) -> str:
        from hapnet.ext.study.markdown import html

        return html(self.plan, self.groups)


def compare(
    couplings: str | Sequence[str] | None = None,
    links: str | Sequence[str] | Mapping[str, str | tuple[str, str]] | None = None,
    *,
    operators: str | Sequence[str] | None = None,
    seeds: Sequence[int] | None = None,
    deadbands: Sequence[float] | None = None,
    params: Params | Mapping[str, object] | None = None,
    directory: str | PathLike[str] | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Comparison:
    """Run each coupling over each link, with each hand and seed, in virtual time, as `hapnet compare` does.

    ``compare(["pspm", "zoh"], ["4g", "leo"])`` runs four cases of 10 s, and the local wall.

    couplings : names, with parameters after colons (``"pspm:rendering=paper"``). None: all of hapnet's couplings.
    links : profiles' names, or names with tc-netem's syntax, as one text or as up and down. None: ideal, lan, 4g and
        intercontinental.
    operators : hands, as for `--operator`. None: ``press@light`` or, if no other list is given, four hands.
    seeds : None: only 0. deadbands : Weber fractions, each tried with each coupling.
    params : of all cases, or changes to the defaults of a comparison (`hapnet.ext.study.plans.BASE`).
    directory : stores the results of all cases; the same comparison continues there. None: they are not stored.
    workers : processes; 0: one per core. With more than 1 the program needs ``if __name__ == "__main__":``.

    Raises InvalidParameter, netem.NetemError: one line that names the value and what is allowed. HapnetError: the
    processes cannot run, or `directory` cannot be written.
    """
    (plan,) = plans(
        BASE if params is None else params if isinstance(params, Params) else BASE.set(params),
        couplings=_names(couplings),
        links={name: _both(words) for name, words in links.items()} if isinstance(links, Mapping) else _names(links),
        operators=_names(operators),
        seeds=seeds,
        deadbands=deadbands,
    ).values()
    spec = plan.spec
    with journal_in(directory, spec, spec.cases()) as journal:
        run_all(journal, workers, progress)
        return Comparison.of(plan, journal)


def _names(given: str | Sequence[str] | None) -> Sequence[str] | None:
    return [given] if isinstance(given, str) else given


def _both(words: str | tuple[str, str]) -> tuple[str, str]:
    return (words, words) if isinstance(words, str) else words
