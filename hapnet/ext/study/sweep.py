"""`hapnet.sweep`: runs every combination of parameters, links and seeds, and returns a table of the measures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.errors import MissingLibrary
from hapnet.ext.study import export
from hapnet.ext.study.export import Table
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.run import Progress, journal_in, run_all
from hapnet.ext.study.spec import Spec, tables_in

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN = 20


@dataclass(frozen=True)
class SweepResult:
    """The results of a sweep, a row for each case that was run.

    columns : by name: ``case``, the varied values, ``seed``, ``link``, the metrics, ``error`` (None: it ran), the time
    it took (``wall_s``) and its ``worker``. None for a missing value.
    """

    columns: Table

    @classmethod
    def of(cls, journal: Journal) -> SweepResult:
        """The result from the finished cases of a journal."""
        return cls(export.table(journal))

    def __len__(self) -> int:
        return len(self.columns["case"])

    def __repr__(self) -> str:
        return f"SweepResult({len(self)} cases, {sum(self.errors.values())} failed)"

    @property
    def errors(self) -> Counter[str]:
        """The errors of failed cases, each with the number of cases."""
        return Counter(error for error in self.columns["error"] if error is not None)

    @property
    def broken(self) -> int:
        """The number of cases in which the coupling claims to be passive but was not."""
        return sum(value == 0.0 for value in self.columns.get("claim_kept", ()))

    def rows(self) -> list[dict[str, Any]]:
        """A row for each case, sorted by case, for ``pandas.DataFrame`` and ``csv.DictWriter``."""
        return [dict(zip(self.columns, row, strict=True)) for row in zip(*self.columns.values(), strict=True)]

    def to_pandas(self) -> DataFrame:
        """The results as a pandas table. Raises MissingLibrary if pandas is not installed."""
        try:
            import pandas
        except ImportError as error:
            raise MissingLibrary("a table", "pandas", "pandas") from error
        return pandas.DataFrame(self.columns)

    def write(self, directory: str | PathLike[str], endings: Iterable[str] = ("csv",)) -> list[Path]:
        """Write ``results.csv`` and, with the ending ``parquet``, ``results.parquet``. Raises RecordingError."""
        return export.write(self.columns, Path(directory), endings)

    def _repr_html_(self) -> str:
        from hapnet.ext.pictures.html import element, join, table

        names = [name for name in self.columns if name not in export.TIMING]
        rows = [tuple("" if row[name] is None else str(row[name]) for name in names) for row in self.rows()[:_SHOWN]]
        more = f", of which {_SHOWN} are shown" if len(self) > _SHOWN else ""
        return join(element("p", f"{len(self)} cases{more}"), table(tuple(names), rows))


def sweep(
    spec: str | PathLike[str] | Mapping[str, Any],
    *,
    changes: Mapping[str, object] | None = None,
    directory: str | PathLike[str] | None = None,
    fresh: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
) -> SweepResult:
    """Run every combination that a spec lists, in virtual time, as `hapnet sweep` does.

    ``sweep({"fixed": {"duration_s": 5}, "vary": {"link": ["lan", "4g"], "seed": "0:10"}})`` runs 20 cases.

    spec : a TOML file, or its tables. changes : override its fixed values.
    directory : stores the results of all cases; the same sweep continues there, unless `fresh` discards them. None:
        they are not stored.
    workers : processes; 0: one per core. With more than 1 the program needs ``if __name__ == "__main__":``.

    Raises InvalidParameter: an entry of the spec is not allowed. HapnetError: `directory` cannot be written, or has
    the journal of another sweep.
    """
    with tables_in(spec, "sweep") as (name, tables):
        wanted = Spec.of_tables(name, tables, changes)
    with journal_in(directory, wanted, wanted.cases(), fresh=fresh) as journal:
        run_all(journal, workers, progress)
        return SweepResult.of(journal)
