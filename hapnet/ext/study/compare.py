"""Comparisons of couplings: each with the same links, hands and seeds, and the measures over all of these."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from hapnet.assembly.springs import limit
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics import METRICS
from hapnet.ext.study.case import DEADBAND, Measures
from hapnet.ext.study.journal import JournalRow
from hapnet.ext.study.spec import LINK, SEED, Spec, Values
from hapnet.ext.study.statistics import Spread, spreads
from hapnet.params import RELAXED_HAND, Params, follows
from hapnet.summary.verdict import ROUNDING_J

NAME = "compare"
LIGHT = "@light"
"""Suffix of an operator's name that stands for a relaxed hand. A firm hand damps the oscillations of a bad coupling."""


def parted(text: str, flag: str = "--coupling") -> tuple[str, dict[str, str]]:
    """Split ``pspm:rendering=paper`` into the name and the parameters that are set; any number may follow.

    Raises InvalidParameter: a parameter is set twice; the message names `flag`.
    """
    name, *rest = text.split(":")
    if rest and "=" not in rest[0]:
        name = f"{name}:{rest.pop(0)}"  # a user's own law, module:NAME
    settings: dict[str, str] = {}
    for word in rest:
        parameter, equals, value = (part.strip() for part in word.partition("="))
        if not equals or parameter in settings:
            raise InvalidParameter(flag, text, "a name, and PARAMETER=VALUE after each further colon, once each")
        settings[parameter] = value
    return name.strip(), settings


def hand(operator: str) -> tuple[str, dict[str, object]]:
    """Split ``press@light:operator_model.reach_s=0.5`` into the operator's name and the parameters that are set.

    Raises InvalidParameter: a parameter is set twice.
    """
    name, own = parted(operator, "--operator")
    relaxed = RELAXED_HAND if name.endswith(LIGHT) else {}
    return name.removesuffix(LIGHT), {**relaxed, **own}


class Variant(NamedTuple):
    """A compared coupling with the Weber fraction of its deadband (0: none).

    coupling : its name, and parameters of its own, as `parted` reads them.
    """

    coupling: str
    deadband: float = 0.0

    def __str__(self) -> str:
        return f"{self.coupling}, deadband {100.0 * self.deadband:g} %" if self.deadband else self.coupling


LOCAL = Variant("local wall")
_IDEAL = {"up": "", "down": ""}


def local_wall(params: Params) -> str:
    """The coupling of the local wall with its parameters, as in `--coupling`; "": the device's limit is not known.

    It is the best that a device can render without a network: a held spring at the wall, with the stages and the same
    servo, over an ideal link, with a world that steps at 1 kHz. It is as stiff as the device renders alone
    (`hapnet.couplings.stiffness.local_limit`), and at most as stiff as the wall:

        felt = K K_w / (K' + K_w) = min(limit, K_w)

    A pair of robots has none: its wall is the follower's.
    """
    if follows(params):
        return ""
    most, wall, spring = limit(params), params.world.wall.stiffness, params.world.stiffness
    if most <= 0.0 or wall <= 0.0 or not isinstance(spring, float):
        return ""
    own = {"rendering": "hapnet", "device.stiffness": f"{min(most, wall) * (spring + wall) / wall:.6g}"}
    own |= dict.fromkeys(("world.step_min_s", "world.step_max_s"), "0.001")
    return ":".join(["zoh", *(f"{name}={value}" for name, value in own.items())])


@dataclass(frozen=True)
class ComparedRun:
    """A run of a comparison: a variant over a link, with an operator and a seed."""

    variant: Variant
    link: str
    operator: str
    seed: int
    params: Params

    @property
    def about(self) -> dict[str, Any]:
        """The description of the variant, in columns."""
        return {**self.variant._asdict(), "link": self.link, "operator": self.operator, "seed": self.seed}

    def __str__(self) -> str:
        return f"{self.variant} over {self.link}, {self.operator}, seed {self.seed}"


@dataclass(frozen=True)
class RunMeasures:
    """The measures of a case, or one line with the reason why it failed."""

    case: ComparedRun
    measures: Measures | None
    error: str | None = None


@dataclass(frozen=True)
class Plan:
    """The plan of a comparison.

    params : of all cases, except for the fields below.
    couplings : each as `Variant.coupling`. links : by name, the text of the uplink and of the downlink.
    operators : as `Params.operator`, followed by `LIGHT` for a relaxed hand, and by the operator's parameters (`hand`).
    deadbands : tried with each coupling. extra : further variants of these couplings.
    local : the coupling of the local wall (`local_wall`), run once a hand and seed; "": none.
    """

    params: Params
    couplings: tuple[str, ...]
    links: Mapping[str, tuple[str, str]]
    operators: tuple[str, ...]
    seeds: tuple[int, ...]
    deadbands: tuple[float, ...] = (0.0,)
    extra: tuple[Variant, ...] = ()
    local: str = ""

    @property
    def variants(self) -> list[Variant]:
        """All variants in the order of their couplings, the extra ones included."""
        every = [Variant(coupling, deadband) for coupling in self.couplings for deadband in self.deadbands]
        return sorted({*every, *self.extra}, key=lambda each: (self.couplings.index(each.coupling), each.deadband))

    @property
    def rows(self) -> list[Variant]:
        """The rows of a table: all variants, and the local wall."""
        return [*self.variants, *([LOCAL] if self.local else [])]

    def cases(self) -> list[ComparedRun]:
        """Every case except the local wall. Cases that differ only in their link are neighbours, as they share a
        reference run.
        """
        by_coupling = [[each for each in self.variants if each.coupling == coupling] for coupling in self.couplings]
        return [
            self.case(variant, link, operator, seed)
            for variants, operator, seed in product(by_coupling, self.operators, self.seeds)
            for variant, link in product(variants, self.links)
        ]

    def local_cases(self) -> list[ComparedRun]:
        """The local wall beside the cases of each link; with the same hand and seed it is the same run."""
        parts = product(self.operators, self.seeds, self.links) if self.local else ()
        return [self.case(LOCAL, link, operator, seed) for operator, seed, link in parts]

    def case(self, variant: Variant, link: str, operator: str, seed: int) -> ComparedRun:
        """The case with these settings. Raises InvalidParameter if its parameters do not go together."""
        values = self._values(variant, link, operator)
        directions = values.pop(LINK)
        changes = values | {f"link.{direction}": words for direction, words in directions.items()}
        return ComparedRun(variant, link, operator, seed, self.params.set(changes))

    @property
    def spec(self) -> Spec:
        """The same cases as the spec of a sweep: a product for each hand and each set of variants."""
        alike: dict[str, list[str]] = {}  # couplings by their own parameters
        for one in self.couplings:
            alike.setdefault(json.dumps(self._own(one, self._texts, parted)), []).append(one)
        links = [{"up": up, "down": down} for up, down in self.links.values()]
        sets = [(couplings, list(self.deadbands), links) for couplings in alike.values()]
        sets += [([one.coupling], [one.deadband], links) for one in self.extra]
        sets += [([self.local], [0.0], [dict(_IDEAL)])] if self.local else []
        hands: dict[str, list[str]] = {}
        for one in self.operators:
            hands.setdefault(json.dumps(self._own(one, self.operators, hand)), []).append(one)
        products: tuple[dict[str, list[Any]], ...] = tuple(
            {
                "coupling": [parted(one)[0] for one in couplings],
                DEADBAND: deadbands,
                "operator": [hand(one)[0] for one in operators],
                **{name: [value] for name, value in self._own(operators[0], self.operators, hand).items()},
                **{name: [value] for name, value in self._own(couplings[0], self._texts, parted).items()},
                LINK: over,
                SEED: list(self.seeds),
            }
            for couplings, deadbands, over in sets
            for operators in hands.values()
        )
        varied = {"link.up", "link.down"}.union(*products)
        fixed = {name: value for name, value in self.params.changes().items() if name not in varied}
        return Spec(NAME, fixed, products)

    def outcomes(self, rows: Iterable[JournalRow]) -> list[RunMeasures]:
        """The outcomes of the cases, in order, from the journal's rows for `spec`. All cases must have been run."""
        spec, found = self.spec, {row.case.key: row for row in rows}
        digests: dict[tuple[Variant, str, str], str] = {}
        outcomes = []
        for case in [*self.cases(), *self.local_cases()]:
            about = case.variant, case.link, case.operator
            if about not in digests:
                digests[about] = spec.digest(self._values(*about))
            row = found[f"{digests[about]}-{case.seed}"]
            measures = {name: row.measures.get(name) for name in METRICS}  # an older journal lacks new metrics
            outcomes.append(RunMeasures(case, measures if row.error is None else None, row.error))
        return outcomes

    def _values(self, variant: Variant, link: str, operator: str) -> Values:
        up, down = self.links[link]
        coupling, over = variant.coupling, {"up": up, "down": down}
        if variant == LOCAL:
            coupling, over = self.local, dict(_IDEAL)
        return {
            "coupling": parted(coupling)[0],
            DEADBAND: variant.deadband,
            "operator": hand(operator)[0],
            **self._own(operator, self.operators, hand),
            **self._own(coupling, self._texts, parted),
            LINK: over,
        }

    @property
    def _texts(self) -> tuple[str, ...]:
        """Every coupling with its own parameters, that of the local wall included."""
        return (*self.couplings, *([self.local] if self.local else []))

    def _own(self, word: str, every: Sequence[str], read: Callable[[str], tuple[str, Mapping[str, object]]]) -> Values:
        """The values for this coupling or operator of all parameters that any coupling or operator sets (`read`).

        Parameters that neither `word` nor the comparison sets are left out.
        """
        own = read(word)[1]
        names = dict.fromkeys(name for one in every for name in read(one)[1])
        return {
            name: own.get(name, self.params.get(name)) for name in names if name in own or name in self.params.given
        }


@dataclass(frozen=True)
class Group:
    """The cases of a variant over a link, with one operator or with all (None).

    `spreads` contains the metrics for which at least one case has a value. `passive` and `hand_passive` : the number of
    cases in which the two-port margin, and the margin at the hand's port, were not negative. `lost` : the measures of
    the cases that were not passive.
    """

    variant: Variant
    link: str
    operator: str | None
    cases: int
    failed: int
    passive: int
    hand_passive: int
    spreads: Mapping[str, Spread]
    lost: Sequence[Measures] = ()

    @property
    def measured(self) -> int:
        return self.cases - self.failed

    def median(self, metric: str) -> float | None:
        spread = self.spreads.get(metric)
        return None if spread is None else spread.median


def by_hand(outcomes: Iterable[RunMeasures]) -> list[list[Measures]]:
    """The measures of the cases that did not fail, in one list for each operator."""
    hands: dict[str, list[Measures]] = {}
    for one in outcomes:
        if one.measures is not None:
            hands.setdefault(one.case.operator, []).append(one.measures)
    return list(hands.values())


def groups(plan: Plan, outcomes: Sequence[RunMeasures]) -> list[Group]:
    """The groups: for each link and variant a group over all operators and, if there are several, one for each."""
    each: tuple[str | None, ...] = plan.operators if len(plan.operators) > 1 else ()
    return [
        _group(variant, link, operator, outcomes)
        for link, variant, operator in product(plan.links, plan.rows, (None, *each))
    ]


def _group(variant: Variant, link: str, operator: str | None, outcomes: Sequence[RunMeasures]) -> Group:
    ours = [
        one for one in outcomes
        if (one.case.variant, one.case.link) == (variant, link) and operator in (None, one.case.operator)
    ]  # fmt: skip
    known = [one.measures for one in ours if one.measures is not None]
    return Group(
        variant,
        link,
        operator,
        len(ours),
        len(ours) - len(known),
        _positive(known, "margin_J"),
        _positive(known, "hand_margin_J"),
        dict(spreads(by_hand(ours))),
        [one for one in known if not _positive([one], "margin_J")],
    )


def _positive(known: Sequence[Measures], margin: str) -> int:
    """The number of cases whose margin is not negative, up to rounding."""
    return sum((value := measures[margin]) is not None and value >= -ROUNDING_J for measures in known)
