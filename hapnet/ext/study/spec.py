"""The specification of a sweep: a TOML file with fixed and varied parameters, and the cases that follow from it.

::

    [fixed]                                  # as --params takes them, and link
    duration_s = 10

    [vary]                                   # every combination is a case
    coupling = ["pspm", "zoh"]
    link = ["lan", "4g", "delay 40ms 10ms loss 2%", { up = "dsl", down = "lan" }]
    device.stiffness = { from = 50, to = 400, steps = 4, scale = "log" }
    seed = "0:10"

Several ``[[vary]]`` tables are several such products; a case in more than one of them is run once.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.file_content import read_toml
from hapnet.param_values import LARGEST_SEED, flatten
from hapnet.params import Params
from netem.errors import NetemError
from netem.profile import PRESETS, LinkProfile

Values = dict[str, Any]
"""Values as TOML has them, by name: parameters by their dotted names, `LINK` and `SEED`."""

LINK, SEED = "link", "seed"
"""Names that may vary besides parameters: the link of both directions (a profile's name, tc-netem's syntax, or {up,
down}), and the seed."""

MOST = 100_000
"""The largest number of cases in a sweep."""

_PLAIN = Params()
_RANGE = ("from", "to", "steps", "scale")
_ALLOWED = "a list, or a range such as {from = 50, to = 400, steps = 8, scale = 'log'}"
_DIGITS = 12  # of a number within a range: 0.3, not 0.30000000000000004


@dataclass(frozen=True)
class Case:
    """A run of a sweep. `values`: everything that varies except the seed. `key`: a digest of all that the spec sets.

    unset : names that vary only in other products, so that this run leaves them at their defaults.
    """

    number: int
    values: Values
    seed: int
    key: str
    unset: tuple[str, ...] = ()

    @property
    def given(self) -> Values:
        """The values that this run sets."""
        return {name: value for name, value in self.values.items() if name not in self.unset}

    @property
    def parameters(self) -> str:
        """The part of the key that is equal for cases that differ only in their seeds."""
        return self.key.rpartition("-")[0]


@dataclass(frozen=True)
class Spec:
    """The specification of a sweep.

    fixed : fixed parameters, `LINK` and `SEED`. products : the varied values of each product, in the file's order.
    """

    name: str
    fixed: Values
    products: tuple[dict[str, list[Any]], ...]

    @classmethod
    def read(cls, file: Path, assignments: Mapping[str, object] | None = None) -> Spec:
        """The spec in `file`; `assignments` override its fixed values.

        Raises InvalidParameter: the file cannot be read, or an entry is not allowed; the message names the entry.
        """
        return cls.of_tables(file.stem, table_of(file), assignments)

    @classmethod
    def of_tables(cls, name: str, tables: Values, assignments: Mapping[str, object] | None = None) -> Spec:
        """The spec in a file's `tables`; raises as `read` does."""
        for word in tables:
            known("table", word, ("fixed", "vary"), "[fixed], or [vary]")
        return cls.of(name, tables, assignments)

    @classmethod
    def of(
        cls, name: str, table: Values, assignments: Mapping[str, object] | None = None, section: str = "vary"
    ) -> Spec:
        """The spec in `table`, with the varied values under `section`; raises as `read` does."""
        fixed, vary = table.get("fixed", {}), table.get(section, [])
        blocks = vary if isinstance(vary, list) else [vary]
        if not isinstance(fixed, Mapping):
            raise InvalidParameter("fixed", fixed, "a table, [fixed]")
        if not blocks or not all(isinstance(block, Mapping) and block for block in blocks):
            raise InvalidParameter(section, vary, f"a table [{section}] of varied values, or several [[{section}]]")
        products = tuple(dict(_axes(block)) for block in blocks)
        for word, value in (assignments or {}).items():
            if any(word in axes for axes in products):
                raise InvalidParameter("--set", f"{word}={value}", "a parameter that does not vary in the spec")
        given = _fixed(fixed, assignments or {})
        for word in given:
            if all(word in axes for axes in products):
                raise InvalidParameter(word, given[word], f"either under [fixed] or under [{section}]")
        return cls(name, given, products)

    @property
    def varied(self) -> list[str]:
        """The names of everything that varies except the seed, in the order of the file."""
        return [name for name in dict.fromkeys(name for axes in self.products for name in axes) if name != SEED]

    @property
    def count(self) -> int:
        """The number of cases; a case in more than one product counts in each."""
        return sum(math.prod(len(values) for values in axes.values()) for axes in self.products)

    def cases(self, only: slice = slice(None)) -> list[Case]:
        """Every combination, once; the last axis changes fastest. Some combinations may not be valid runs.

        only : the products to use; the keys do not depend on it.

        Raises InvalidParameter: a value is not of its parameter's type, or there are more cases than `MOST`.
        """
        if self.count > MOST:
            raise InvalidParameter("the number of cases", self.count, f"{MOST} at most")
        found: dict[str, Case] = {}
        for axes in self.products[only]:
            free = [name for name in axes if name != SEED]
            digests: dict[str, tuple[Values, str]] = {}
            unset = self._unset({*self.fixed, *axes})
            for combination in product(*axes.values()):
                chosen = dict(zip(axes, combination, strict=True))
                seed = chosen.pop(SEED, self.fixed.get(SEED, 0))
                label = json.dumps([chosen[name] for name in free])
                if label not in digests:
                    every = flat_of(self.fixed, chosen)
                    digests[label] = shown(self.varied, every), self._digest(every, unset)
                values, digest = digests[label]
                key = f"{digest}-{seed}"
                found.setdefault(key, Case(len(found), values, seed, key, unset))
        return list(found.values())

    def digest(self, values: Values) -> str:
        """The beginning of the keys of the cases with these `values`; the seed follows."""
        return self._digest(flat_of(self.fixed, values), self._unset({*self.fixed, *values}))

    def _unset(self, given: Collection[str]) -> tuple[str, ...]:
        """Return the names that vary in some product, but are not in `given`."""
        return tuple(name for name in self.varied if name not in given)

    def _digest(self, every: Values, unset: Collection[str]) -> str:
        """A digest of all values that the spec sets in a case; values left at their defaults are not part of it."""
        names = {name for name in (*self.fixed, *self.varied) if name != SEED and name not in unset}
        if LINK in names:
            names = names - {LINK} | {"link.up", "link.down"}
        chosen = {name: every[name] for name in names}
        chosen |= {name: profile(name, chosen[name]) for name in ("link.up", "link.down") if name in chosen}
        return hashlib.sha256(json.dumps(chosen, sort_keys=True).encode()).hexdigest()[:16]


@cache
def _defaults() -> Values:
    """Every parameter with its default; a function and not a constant, as it loads the laws."""
    return _PLAIN.flat()


def params_of(fixed: Values, values: Values) -> Params:
    """The parameters of a case; raises InvalidParameter as `Params.set` does."""
    return _PLAIN.set({**_spelled(fixed), **_spelled(values)})


def shown(varied: Collection[str], every: Values) -> Values:
    """The values of the `varied` names, from all parameters by dotted names."""
    up, down = every["link.up"], every["link.down"]
    link = up if up == down else {"up": up, "down": down}
    return {name: link if name == LINK else every[name] for name in varied}


def flat_of(fixed: Values, values: Values) -> Values:
    """All parameters of a case by dotted names, even if it is not a valid run; raises as `Params.typed` does."""
    return {**_defaults(), **_PLAIN.typed({**_spelled(fixed), **_spelled(values)})}


def entries(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The entries of nested tables under dotted names; a range is one entry."""
    for word, given in table.items():
        if isinstance(given, Mapping) and given and not set(given) & set(_RANGE):
            yield from entries(given, f"{prefix}{word}.")
        else:
            yield prefix + word, given


def table_of(file: Path) -> Values:
    """The table in a TOML file. Raises InvalidParameter."""
    try:
        return read_toml(file)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InvalidParameter("SPEC", str(file), f"a TOML file ({why})") from None


@contextmanager
def in_file(file: Path) -> Iterator[None]:
    """A context in which the error of an entry names the file too."""
    try:
        yield
    except InvalidParameter as error:
        if error.name.startswith("--") or error.value == str(file):  # a flag, or the file itself
            raise
        raise error.renamed(f"{file}: {error.name}") from error


@contextmanager
def tables_in(spec: str | PathLike[str] | Mapping[str, Any], name: str) -> Iterator[tuple[str, Values]]:
    """A context with a spec's name and tables: of a file, which errors then name too, or the given tables and name."""
    if isinstance(spec, Mapping):
        yield name, dict(spec)
    else:
        with in_file(file := Path(spec)):
            yield file.stem, table_of(file)


def known(what: str, word: str, words: Collection[str], allowed: str) -> None:
    """Raise InvalidParameter unless `word` is one of `words`."""
    if word not in words:
        raise InvalidParameter(what, word, allowed, words)


def number(value: object) -> bool:
    """Whether this is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def link_words(up: str, down: str) -> str:
    """Both directions of a link as text; only one if they are equal."""
    up, down = up or "ideal", down or "ideal"
    return up if up == down else f"up {up}, down {down}"


def value_words(name: str, value: Any) -> str:
    """A varied value as text, for tables and figures."""
    if name == LINK:
        return link_words(value["up"], value["down"]) if isinstance(value, Mapping) else link_words(value, value)
    return value if isinstance(value, str) else json.dumps(value)


def _spelled(values: Values) -> Values:
    """The values by dotted parameter names: a link becomes both directions, and the seed is left out."""
    plain = {name: value for name, value in values.items() if name not in (LINK, SEED)}
    if LINK in values:
        link = values[LINK]
        directions = link if isinstance(link, Mapping) else {"up": link, "down": link}
        plain = {f"link.{direction}": words for direction, words in directions.items()} | plain
    return plain


def _fixed(table: Mapping[str, Any], assignments: Mapping[str, object]) -> Values:
    fixed = {**dict(flatten(table)), **assignments}
    for name, value in fixed.items():
        _parameter(name)
        if name == SEED:
            fixed[name] = value = int(value) if isinstance(value, str) and value.isdecimal() else value
            _seed(value, "a whole number, 0 or above")
        elif name == LINK:
            _link(value)
    return fixed


def _axes(table: Mapping[str, Any]) -> Iterator[tuple[str, list[Any]]]:
    """Names and their values, from nested tables."""
    every = dict(entries(table))
    for name, given in every.items():
        _parameter(name)
        if name.startswith("link.") and LINK in every:
            raise InvalidParameter(name, given, f"either {name} or link")
        values = _values_of(name, given)
        if not values:
            raise InvalidParameter(name, given, f"at least one value: {_ALLOWED}")
        yield name, values


def _values_of(name: str, given: object) -> list[Any]:
    if name == SEED and isinstance(given, str):
        words = re.fullmatch(r"(\d{1,18}):(\d{1,18})", given.strip())
        if words is None or int(words[1]) >= int(words[2]):
            raise InvalidParameter(SEED, given, "'A:B', the seeds from A to B - 1, such as '0:10'")
        if int(words[2]) - int(words[1]) > MOST:
            raise InvalidParameter(SEED, given, f"{MOST} cases at most")
        return list(range(int(words[1]), int(words[2])))
    if isinstance(given, Mapping):
        return _range(name, given)
    if not isinstance(given, list):
        raise InvalidParameter(name, given, f"{_ALLOWED}; what does not vary belongs under [fixed]")
    for value in given:
        if name == SEED:
            _seed(value, "whole numbers, 0 or above")
        elif name == LINK:
            _link(value)
    return given


def _range(name: str, given: Mapping[str, Any]) -> list[Any]:
    """The numbers of a range, both ends included."""
    for word in given:
        known(name, word, _RANGE, "from, to, steps and scale")
    whole = name == SEED or isinstance(_defaults().get(name), int)
    if name == LINK or isinstance(_defaults().get(name), bool | str):
        raise InvalidParameter(name, dict(given), "a list: these values have no range")
    ends: list[Any] = [given.get("from"), given.get("to")]
    if not all(number(end) for end in ends) or ends[0] == ends[1]:
        raise InvalidParameter(name, dict(given), "a range {from = A, to = B} between two different numbers")
    first, last = ends
    if whole and not all(isinstance(end, int) for end in ends):
        raise InvalidParameter(name, dict(given), "whole numbers")
    if name == SEED and not 0 <= min(first, last) <= max(first, last) <= LARGEST_SEED:
        raise InvalidParameter(name, dict(given), "whole numbers, 0 or above, of 64 bits")
    if "steps" not in given and not whole:
        raise InvalidParameter(name, dict(given), "a range with the number of its values: steps = N")
    steps = given.get("steps", abs(last - first) + 1 if whole else None)
    if not isinstance(steps, int) or isinstance(steps, bool) or not 2 <= steps <= MOST:
        raise InvalidParameter(f"steps of {name}", steps, f"a whole number, 2 to {MOST}")
    scale = given.get("scale", "linear")
    if scale not in ("linear", "log"):
        raise InvalidParameter(f"scale of {name}", scale, "linear, or log")
    if scale == "log":
        if min(first, last) <= 0:
            raise InvalidParameter(name, dict(given), "from and to above 0 on a log scale")
        inner = [first * (last / first) ** (k / (steps - 1)) for k in range(1, steps - 1)]
    else:
        inner = [first + (last - first) * k / (steps - 1) for k in range(1, steps - 1)]
    rounded = [round(x) if whole else float(f"{x:.{_DIGITS}g}") for x in inner]
    values = [first, *rounded, last]
    if len(set(values)) < steps:
        raise InvalidParameter(
            f"steps of {name}", steps, f"no more than there are whole numbers from {first} to {last}"
        )
    return values


def _parameter(name: str) -> None:
    known("parameter", name, (*_defaults(), LINK, SEED), "a parameter of --show-params, link or seed")


def _seed(value: object, allowed: str) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= LARGEST_SEED:
        raise InvalidParameter(SEED, value, f"{allowed}, of 64 bits")


def _link(value: object) -> None:
    directions: Mapping[str, Any] = value if isinstance(value, Mapping) else {"up": value, "down": value}
    if set(directions) != {"up", "down"} or not all(isinstance(words, str) for words in directions.values()):
        raise InvalidParameter(LINK, value, "a profile's name, tc-netem's syntax, or {up = ..., down = ...} with these")
    for words in directions.values():
        profile(LINK, words)


def profile(name: str, text: str) -> str:
    """A link in tc-netem's syntax; equal links give equal texts."""
    try:
        return str(LinkProfile.named(text))
    except NetemError as error:
        allowed = f"a profile of `netem profiles`; or tc-netem's syntax ({error})"
        raise InvalidParameter(name, text, allowed, PRESETS) from None
