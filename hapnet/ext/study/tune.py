"""`hapnet.tune`: searches the parameters that are best for an objective, and scores them on other cases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

from hapnet.ext.pictures.style import also_to
from hapnet.ext.study import tune_results
from hapnet.ext.study.run import Progress, journal_in, run_all
from hapnet.ext.study.search import Search, base, most_cases
from hapnet.ext.study.search_space import need_library
from hapnet.ext.study.spec import tables_in
from hapnet.ext.study.tune_spec import TuneSpec
from hapnet.params import Params

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Tuning:
    """The result of a tuning: `search` has its trials and their worth."""

    search: Search

    def __repr__(self) -> str:
        return f"Tuning({len(self.search.trials)} trials; {self.found or 'none keeps all constraints'})"

    @property
    def found(self) -> dict[str, Any] | None:
        """The best values that keep all constraints, by their parameters' names.

        None: no trial keeps all constraints.
        """
        return None if self.search.best is None else dict(self.search.trials[self.search.best].values)

    def params(self, base: Params | None = None) -> Params:
        """`base`, or the defaults, with the values found."""
        return (Params() if base is None else base).set(self.found or {})

    def rows(self) -> list[dict[str, Any]]:
        """A row for each trial: its values, its objective with every term, and the constraints that it kept."""
        return tune_results.trials(self.search)

    def as_dict(self) -> dict[str, Any]:
        """The result as in `hapnet tune --json`, with the values found beside the defaults, on both kinds of cases."""
        return tune_results.as_dict(self.search)

    def plot(self, file: str | PathLike[str] | None = None) -> Figure:
        """The objective over the trials and over each parameter; written to `file`, if given."""
        from hapnet.ext.study.figures import tuned

        return also_to(tuned(self.search), file)

    def _repr_html_(self) -> str:
        from hapnet.ext.pictures.html import table

        found = self.found or {}
        rows = [(one.name, str(one.default), str(found.get(one.name, "–")), str(one)) for one in self.search.spec.space]
        return table(("parameter", "default", "found", "range"), rows, caption=f"{len(self.search.trials)} trials")


def tune(
    spec: str | PathLike[str] | Mapping[str, Any],
    *,
    changes: Mapping[str, object] | None = None,
    directory: str | PathLike[str] | None = None,
    fresh: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
) -> Tuning:
    """Search the parameters that are best for an objective and break no constraint, as `hapnet tune` does.

    spec : a TOML file, or its tables: ``tune``, ``search``, ``fixed``, ``vary`` and ``score``; `examples/tune/` has
        some. changes : override its fixed values.
    directory, fresh, workers, progress : as for `sweep`.

    Raises InvalidParameter: an entry of the spec is not allowed. MissingLibrary: optuna is not installed (extra
    `tune`). HapnetError: `directory` cannot be written, or has the journal of another tuning.
    """
    with tables_in(spec, "tune") as (name, tables):
        wanted = TuneSpec.of_tables(name, tables, changes)
    need_library()
    tuned, scored = base(wanted)
    with journal_in(directory, wanted.whole(wanted.defaults), [*tuned, *scored], fresh=fresh) as journal:
        search = Search(wanted, journal)
        run_all(journal, workers, progress, search.rounds(), most_cases(wanted))
        return Tuning(search)
