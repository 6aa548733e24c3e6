"""Describe a link in the syntax of Linux's tc-netem: convert text to a frozen `LinkProfile` and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from netem import effects, recorded, tc, units
from netem.delay_table import DelayTable
from netem.effects import MOST_RESENDS, FourStateLoss, GilbertElliottLoss, Loss, RandomLoss, Resend, Slot
from netem.errors import ProfileError
from netem.impairment import Impairment
from netem.impairments import IMPAIRMENTS
from netem.presets import ALIASES, PRESETS
from netem.rate_trace import RateTrace
from netem.trace import CapacityTrace, ConditionTrace, load_trace
from netem.words import Words

__all__ = ["PRESETS", "LinkProfile", "compose"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkProfile:
    """The effects of a link on the messages of one direction; times in ns, probabilities and correlations in [0, 1].

    The default does nothing. `parse` reads tc-netem's syntax and `str` writes it; ``parse(str(p)) == p``. `limit` is
    the most messages in flight, 1000 by default as in tc, and `limit_bytes` the most bytes (0: no limit); the link
    counts those that it drops above that. A `trace` replaces a rate. A `csv` adds its delay and its loss to the others.
    They and a `DelayTable` hold the contents of their files. `others` are of `netem.impairments`.

    More than twenty attributes: one for each setting that a profile can have.

    Raises ProfileError: a value is out of range, or two values exclude each other; also from `parse` and `replace`.
    """

    delay_ns: int = 0
    jitter_ns: int = 0
    delay_correlation: float = 0.0
    distribution: str | DelayTable = "uniform"
    loss: Loss | None = None
    resend: Resend | None = None
    corrupt: float = 0.0
    corrupt_correlation: float = 0.0
    reorder: float = 0.0
    reorder_correlation: float = 0.0
    gap: int = 1
    rate_bit_s: int = 0
    overhead: int = 0
    cell_size: int = 0
    cell_overhead: int = 0
    slot: Slot | None = None
    trace: CapacityTrace | RateTrace | None = None
    csv: ConditionTrace | None = None
    limit: int = 1000
    limit_bytes: int = 0
    others: tuple[Impairment, ...] = ()
    seed: int | None = None

    def __post_init__(self) -> None:
        for name in ("delay_ns", "jitter_ns"):
            effects.check_int(name, getattr(self, name), 0, units.MAX_TIME_NS)
        for name in ("delay_correlation", "corrupt", "corrupt_correlation", "reorder", "reorder_correlation"):
            effects.check_fraction(name.replace("_", " "), getattr(self, name))
        effects.check_distribution("distribution", self.distribution)
        if self.distribution != "uniform" and self.jitter_ns == 0:
            why = "it needs a delay with jitter before it, such as 'delay 40ms 10ms'"
            raise ProfileError("distribution", str(self.distribution), "", why=why)
        if self.reorder and self.delay_ns == 0 and self.csv is None:
            raise ProfileError(
                "reorder",
                units.format_fraction(self.reorder),
                "",
                why="it needs a delay to overtake, such as 'delay 40ms'",
            )
        effects.check_int("gap", self.gap, 1, 2**32 - 1)
        effects.check_int("rate", self.rate_bit_s, 0, units.MAX_RATE_BIT_S)
        effects.check_int("rate overhead", self.overhead, -(2**31), 2**31 - 1)
        effects.check_int("rate cellsize", self.cell_size, 0, 2**32 - 1)
        effects.check_int("rate celloverhead", self.cell_overhead, -self.cell_size, 2**31 - 1)
        if self.trace is not None and (self.rate_bit_s or self.overhead or self.cell_size):
            raise ProfileError("trace", self.trace.path, "", why="a trace sets the rate; leave rate out")
        effects.check_int("limit", self.limit, 1, 2**63 - 1)
        effects.check_int("limit bytes", self.limit_bytes, 0, 2**63 - 1)
        if self.seed is not None:
            effects.check_int("seed", self.seed, 0, 2**64 - 1)

    def __str__(self) -> str:
        """The profile in tc-netem's syntax. Default values are left out, so the ideal link is the empty string."""
        out = []
        if self.delay_ns or self.jitter_ns or self.delay_correlation:
            out.append(f"delay {units.format_time(self.delay_ns)}")
            if self.jitter_ns or self.delay_correlation:
                out.append(units.format_time(self.jitter_ns))
            if self.delay_correlation:
                out.append(units.format_fraction(self.delay_correlation))
            if self.distribution != "uniform":
                out.append(f"distribution {self.distribution}")
        if self.loss is not None:
            out.append(str(self.loss))
        if self.resend is not None:
            out.append(str(self.resend))
        if self.corrupt or self.corrupt_correlation:
            out.append("corrupt " + effects.fractions(self.corrupt, self.corrupt_correlation or None))
        if self.reorder or self.reorder_correlation:
            out.append("reorder " + effects.fractions(self.reorder, self.reorder_correlation or None))
        if self.gap != 1:
            # a gap alone means that every gap-th message goes first, so a chance of 0 % is written out
            out.append(f"gap {self.gap}" if out and out[-1].startswith("reorder") else f"reorder 0% gap {self.gap}")
        if self.rate_bit_s or self.overhead or self.cell_size or self.cell_overhead:
            out.append(f"rate {units.format_rate(self.rate_bit_s)}")
            shaping = [self.overhead, self.cell_size, self.cell_overhead]
            while shaping and shaping[-1] == 0:
                shaping.pop()
            out.extend(map(str, shaping))
        if self.slot is not None:
            out.append(str(self.slot))
        out.extend(str(trace) for trace in (self.trace, self.csv) if trace is not None)
        out.extend(map(str, self.others))
        if self.limit != 1000 or self.limit_bytes:
            out.append(f"limit {self.limit}" * (self.limit != 1000) or "limit")
        if self.limit_bytes:
            out.append(f"bytes {self.limit_bytes}")
        if self.seed is not None:
            out.append(f"seed {self.seed}")
        return " ".join(out)

    def replace(self, **changes: Any) -> LinkProfile:
        """A copy with some fields changed, validated again."""
        return dataclasses.replace(self, **changes)

    @classmethod
    def parse(cls, text: str) -> LinkProfile:
        """The profile that a text in tc-netem's syntax describes.

        ``delay T [J [C]]``, ``distribution NAME``, ``loss [random] P [C]``, ``loss state P13 [P31 [P32 [P23 [P14]]]]``,
        ``loss gemodel P [R [1-H [1-K]]]``, ``corrupt P [C]``, ``reorder P [C]``, ``gap D``, ``rate R [OVERHEAD
        [CELLSIZE [CELLOVERHEAD]]]``, ``slot ...``, ``limit [N] [bytes SIZE]``, ``seed N``, in any order; and the words
        of `netem.impairments`, such as ``duplicate P [C]``. A whole command of tc, and what ``tc qdisc show`` prints,
        are read too (`netem.tc`).

        Beyond tc: ``resend N TIME [unordered]`` offers lost messages again (`netem.effects.Resend`; 0: never).
        ``trace FILE`` replaces a rate by delivery opportunities (`netem.trace.CapacityTrace`) or by a rate that changes
        over time (`netem.rate_trace.RateTrace`). ``csv FILE [every TIME]`` adds a delay and a loss that change over
        time (`netem.trace.ConditionTrace`). ``distribution FILE`` draws from measured delays, or gives a delay with
        jitter their shape (`netem.delay_table.DelayTable`). Of these words, a file's name alone stands for the one that
        fits (`netem.recorded`). The files are read at once; a name with spaces needs double quotes.
        """
        return cls(**_read(text)[0])

    @classmethod
    def named(cls, text: str) -> LinkProfile:
        """The profile named `text`, or else the one that its words describe."""
        return cls.preset(name) if (name := text.strip()) in PRESETS or name in ALIASES else cls.parse(text)

    @classmethod
    @cache
    def preset(cls, name: str) -> LinkProfile:
        """A named profile, for one direction; `PRESETS` holds the words of each."""
        name = ALIASES.get(name, name)
        if name not in PRESETS:
            raise ProfileError("profile", name, ", ".join(PRESETS), PRESETS)
        return cls.parse(PRESETS[name])


def compose(
    text: str | None = None,
    preset: str | None = None,
    delay: str | None = None,
    jitter: str | None = None,
    loss: str | None = None,
    reorder: str | None = None,
    rate: str | None = None,
    resend: str | None = None,
    base: LinkProfile | None = None,
) -> LinkProfile:
    """One profile from a command's options, with values as tc writes them: ``"40ms"``, ``"10ms 25%"``.

    Options override a preset. With `words`, they may only set what the words leave out. Without words and preset they
    change `base` (by default a link that does nothing).

    Raises ProfileError: a value is malformed, or two options set the same thing.
    """
    if text is not None and preset is not None:
        raise ProfileError("profile name", preset, "", why=f"give the name {preset} or words, not both")
    if text is not None:
        profile = LinkProfile.parse(text)
    else:
        profile = LinkProfile.preset(preset) if preset is not None else base or LinkProfile()
    named = _read(text or "")[1]
    named |= ({"jitter"} if "delay" in named else set()) | ({"reorder"} if "gap" in named else set())
    fields: dict[str, object] = {}
    given = {"delay": delay, "jitter": jitter, "loss": loss, "resend": resend, "reorder": reorder, "rate": rate}
    for name, value in given.items():
        if value is None:
            continue
        if name in named and not (name == "jitter" and profile.jitter_ns == 0):
            raise ProfileError(name, value, "", why="the words set it too; leave one of the two out")
        cursor = Words(value)
        fields |= _OPTIONS[name](cursor)
        if not cursor.at_end():
            raise ProfileError(name, value, "one setting, such as --delay 40ms, --jitter 10ms, --loss 2%")
    if fields.get("jitter_ns") == 0:
        fields |= {"distribution": "uniform", "delay_correlation": 0.0}
    return profile.replace(**fields)


def _read(text: str) -> tuple[dict[str, Any], set[str]]:
    """The fields that a profile's words set, and the set of words found."""
    words = Words(tc.options(text))
    fields: dict[str, object] = {}
    seen: set[str] = set()
    others: list[Impairment] = []
    while not words.at_end():
        word = tc.full_word(given := words.take("profile"))
        if word not in _GRAMMAR and word not in IMPAIRMENTS and recorded.is_file(given):
            word = recorded.kind_of(given)[0]
            words.put_back()
        if word in _REFUSED:
            raise ProfileError(given, given, "", why=_REFUSED[word])
        if word not in _GRAMMAR and word not in IMPAIRMENTS:
            names = (*_GRAMMAR, *IMPAIRMENTS, *(() if seen else PRESETS))
            raise ProfileError("profile", given, f"one of {', '.join(names)}, or a file that exists", names)
        if word in seen:
            raise ProfileError(word, given, "", why="it is given twice; leave one out")
        seen.add(word)
        if word in IMPAIRMENTS:
            others.append(IMPAIRMENTS[word].read(words))
        else:
            fields |= _GRAMMAR[word](words)
    if others:
        fields["others"] = tuple(others)
    if "gap" in seen and "reorder" not in seen:
        fields["reorder"] = 1.0  # as in tc: every gap-th message, not by chance
    own = fields.get("distribution")
    if isinstance(own, DelayTable) and own.mean_ns and "delay" not in seen:
        fields |= {"delay_ns": own.mean_ns, "jitter_ns": own.std_ns}
        if not own.std_ns:
            del fields["distribution"]
    return fields, seen


def _delay(words: Words) -> dict[str, object]:
    times = words.numbers("delay", units.parse_time, 1, 2)
    correlation = words.numbers("delay", units.parse_fraction, 0, 1) if len(times) == 2 else []
    return dict(zip(("delay_ns", "jitter_ns", "delay_correlation"), times + correlation, strict=False))


def _delay_alone(words: Words) -> dict[str, object]:
    return {"delay_ns": units.parse_time("delay", words.take("delay"))}


def _jitter(words: Words) -> dict[str, object]:
    fields: dict[str, object] = {"jitter_ns": units.parse_time("jitter", words.take("jitter"))}
    correlation = words.numbers("jitter", units.parse_fraction, 0, 1)
    return fields | ({"delay_correlation": correlation[0]} if correlation else {})


def _distribution(words: Words) -> dict[str, object]:
    return {"distribution": _shape("distribution", words)}


def _shape(word: str, words: Words) -> str | DelayTable:
    """The name of a distribution, or a file's."""
    text = words.take(word)
    file = None if text in effects.DISTRIBUTIONS else recorded.table(text)
    return text if file is None else DelayTable.load(file)


def _loss(words: Words) -> dict[str, object]:
    kind = words.take_if("random", "state", "gemodel") or "random"
    if kind == "random":
        return {"loss": RandomLoss(*words.numbers("loss random", units.parse_fraction, 1, 2))}
    p = words.labelled(f"loss {kind}", units.parse_fraction, _LABELS[kind])
    if len(p) == 1:
        p.append(1.0 - p[0])
    return {"loss": FourStateLoss(*p) if kind == "state" else GilbertElliottLoss(*p)}


def _resend(words: Words) -> dict[str, object]:
    times = units.parse_int("resend", words.take("resend"), 0, MOST_RESENDS)
    if not times:  # 0 switches off the resends of a preset
        return {"resend": None}
    after_ns = units.parse_time("resend", words.take("resend"))
    return {"resend": Resend(times, after_ns, ordered=not words.take_if("unordered"))}


def _corrupt(words: Words) -> dict[str, object]:
    p = words.numbers("corrupt", units.parse_fraction, 1, 2)
    return dict(zip(("corrupt", "corrupt_correlation"), p, strict=False))


def _reorder(words: Words) -> dict[str, object]:
    p = words.numbers("reorder", units.parse_fraction, 1, 2)
    return dict(zip(("reorder", "reorder_correlation"), p, strict=False))


def _reorder_and_gap(words: Words) -> dict[str, object]:
    return _reorder(words) | (_gap(words) if words.take_if("gap") else {})


def _gap(words: Words) -> dict[str, object]:
    # in tc, 0 means no reordering by gap; here that is a gap of 1
    return {"gap": max(1, units.parse_int("gap", words.take("gap"), 0, 2**32 - 1))}


def _rate(words: Words) -> dict[str, object]:
    fields: dict[str, object] = {"rate_bit_s": units.parse_rate("rate", words.take("rate"))}
    shaping = words.numbers("rate", lambda word, text: units.parse_int(word, text, -(2**31)), 0, 3)
    fields |= dict(zip(_SHAPING.values(), shaping, strict=False))
    while name := words.take_if(*_SHAPING):  # as tc prints those that are not 0
        fields[_SHAPING[name]] = units.parse_int(f"rate {name}", words.take(f"rate {name}"), -(2**31))
    return fields


def _slot(words: Words) -> dict[str, object]:
    distribution: str | DelayTable = ""
    if words.take_if("distribution"):
        # tc prints no name
        distribution = "uniform" if words.number_follows() else _shape("slot distribution", words)
    # tc always read a bare time of a slot as ns; that of a delay once was in us
    times = words.numbers("slot", lambda word, text: units.parse_time(word, text, "ns"), 2 if distribution else 1, 2)
    limits: dict[str, int] = {}
    while name := words.take_if("packets", "bytes"):
        read = units.parse_size if name == "bytes" else units.parse_int
        limits[name] = read(f"slot {name}", words.take(f"slot {name}"), 0, 2**31 - 1)
    return {"slot": Slot(times[0], times[-1], distribution, **limits)}


def _trace(words: Words) -> dict[str, object]:
    return {"trace": load_trace(words.take("trace"))}


def _csv(words: Words) -> dict[str, object]:
    path = words.take("csv")
    every_ns = units.parse_time("csv every", words.take("csv every")) if words.take_if("every") else 0
    return {"csv": ConditionTrace.load(path, every_ns)}


def _limit(words: Words) -> dict[str, object]:
    fields: dict[str, object] = {}
    if not words.take_if("bytes"):
        text = words.take("limit")
        if not text.lstrip("+-").isdigit():
            raise ProfileError("limit", text, "a whole number of messages from 1, or 'limit bytes 64kb'")
        fields["limit"] = units.parse_int("limit", text, 1)
        if not words.take_if("bytes"):
            return fields
    return fields | {"limit_bytes": units.parse_size("limit bytes", words.take("limit bytes"))}


def _seed(words: Words) -> dict[str, object]:
    return {"seed": units.parse_int("seed", words.take("seed"), 0, 2**64 - 1)}


_LABELS = {"state": ("p13", "p31", "p32", "p23", "p14"), "gemodel": ("p", "r", "1-h", "1-k")}
"""The names that tc prints before the values of a loss model."""

_SHAPING = {"packetoverhead": "overhead", "cellsize": "cell_size", "celloverhead": "cell_overhead"}
"""The names that tc prints before the values after a rate, and their fields."""

_Reader = Callable[[Words], dict[str, object]]
_GRAMMAR: Mapping[str, _Reader] = {
    "delay": _delay,
    "distribution": _distribution,
    "loss": _loss,
    "resend": _resend,
    "corrupt": _corrupt,
    "reorder": _reorder,
    "gap": _gap,
    "rate": _rate,
    "slot": _slot,
    "trace": _trace,
    "csv": _csv,
    "limit": _limit,
    "seed": _seed,
}
_OPTIONS: Mapping[str, _Reader] = {
    "delay": _delay_alone,
    "jitter": _jitter,
    "loss": _loss,
    "resend": _resend,
    "reorder": _reorder_and_gap,
    "rate": _rate,
}
WORDS = frozenset(_GRAMMAR)
"""The words of a profile, but for those of `netem.impairments`."""

_REFUSED = {
    "ecn": "messages have no ECN field to mark; leave it out, and they are lost instead",
}
