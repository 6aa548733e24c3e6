"""Every physical and timing parameter of a run, read from TOML and `--set`, and recorded with the run.

Defaults, units and meanings are in hapnet/param_sections.py, and in the laws' own files (hapnet/ext/laws).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar, cast

from hapnet.errors import InvalidParameter
from hapnet.file_content import read_toml
from hapnet.laws import COUPLING_NAMES, GROUP, built_in, sections, sections_of
from hapnet.loading import only_imported, permitting, published
from hapnet.param_sections import (
    ContactModelParams as ContactModelParams,
    DeviceParams as DeviceParams,
    FollowerParams as FollowerParams,
    LinkParams as LinkParams,
    OperatorParams as OperatorParams,
    WallParams as WallParams,
    WireParams as WireParams,
    WorldParams as WorldParams,
)
from hapnet.param_sources import ASKED, DEFAULT, FILE, FLAG, PROGRAM, RECORDING, RESOLVED, Sources, read as read_sources
from hapnet.param_values import (
    NOT_NEGATIVE as _NOT_NEGATIVE,
    POSITIVE as _POSITIVE,
    RENAMED,
    Range,
    Section,
    check_allowed,
    check_kind,
    converted,
    flatten,
    leaves,
    nested,
    parameter as _p,
    present_name,
    replaced,
    set_by_hand,
    toml_value,
)

LawSection = TypeVar("LawSection")

_BEFORE: Mapping[str, object] = {
    "rendering": "paper", "operator_model.start_periods": 0.0, "operator_model.end_hold_s": 0.0,
    "contact_model.remembers": False, "contact_model.stop_s": 0.0, "contact_model.yields_below": 0.0}  # fmt: skip
"""The values with which older recordings, which lack these entries, were made."""

ARMS = ("omni", "arm:FILE.urdf?tip=LINK")
"""The devices that are simulated arms."""


def is_arm(hardware: str) -> bool:
    """Whether the device of this name is a simulated arm."""
    return hardware.partition("?")[0] == "omni" or hardware.startswith(("omni:", "arm:"))


def is_tool(scene: str) -> bool:
    """Whether the user moves a tool that turns in this scene (`hapnet.ext.tools.scene`)."""
    return scene.lstrip().startswith("tool:")


def arm_file(hardware: str) -> str:
    """The URDF file of ``arm:FILE.urdf?...``; empty for any other device."""
    return hardware[4:].partition("?")[0] if hardware.startswith("arm:") else ""


def is_simulated(hardware: str) -> bool:
    """Whether the device of this name is simulated: a point mass, or an arm."""
    return hardware == "simulated" or is_arm(hardware)


def follows(params: Params) -> bool:
    """True if a robot follows the device, in the virtual mass's place."""
    return params.follower.robot != "none"


def is_real_robot(params: Params) -> bool:
    """True if the robot that follows is real: it has a driver."""
    return params.follower.robot not in ("none", "simulated")


def known_damping(params: Params) -> float:
    """The known part of the device's own damping [Ns/m]: the damping of a simulated device, or the trusted lower bound
    for a real device.
    """
    device = params.device
    return device.own_damping if is_simulated(params.hardware) else device.trusted_damping


@dataclass(frozen=True, repr=False)
class Params(Section):
    """All parameters of a run, each with the source of its value (`hapnet.param_sources`).

    A value that was set is kept, even if it equals the default: no other value replaces it. A section made by hand
    sets the values passed to it, as in ``Params(device=DeviceParams(damping=0.1))``. If all values are passed, as by
    `dataclasses.replace`, it sets the values that differ from the default.

    >>> Params().set({"link.up": "4g", "device.stiffness": 200})
    Params().set({'device.stiffness': 200.0, 'link.up': '4g'})
    """

    scene: str = _p(
        "wall",
        "free, wall, box, paper, moving, joints, solids (sphere, mesh:FILE, sdf:...), tool:box + solids, soft, "
        "wall + grip, mujoco:FILE.xml, module:name",
    )
    operator: str = _p(
        "press", "rest, sine, press, hand-N, strokes-N, writing-N, a recording, module:Class; mouse: hapnet play"
    )
    hardware: str = _p(
        "simulated", "simulated, omni, arm:FILE.urdf?tip=LINK, a name (`hapnet devices`) or module:Class"
    )
    coupling: str = _p("pspm", f"pspm; for comparison {', '.join(COUPLING_NAMES[1:])}, or your own as module:NAME")
    rendering: str = _p("auto", "hapnet (local contact model, prediction) or paper; auto: hapnet for pspm and zoh, "
                   "for the others as much as their authors allow", ("auto", "hapnet", "paper"))  # fmt: skip
    dof: int = _p(0, "degrees of freedom; 0: the scene's own", _NOT_NEGATIVE)
    units: str = _p("auto", "units of the axes: m or rad, for all or one per axis as in m,m,rad; auto: the world's own")
    duration_s: float = _p(10.0, "duration from pairing [s]; 0: until stopped", Range(at_least=0.0, at_most=1e9))
    record_hz: float = _p(200.0, "recorded samples of the device per second [Hz]", _POSITIVE)
    telemetry_hz: float = _p(
        60.0,
        "samples per second that each side publishes for hapnet view [Hz]; 0: none",
        Range(at_least=0.0, at_most=1000.0),
    )
    device: DeviceParams = field(default_factory=DeviceParams)
    operator_model: OperatorParams = field(default_factory=OperatorParams)
    world: WorldParams = field(default_factory=WorldParams)
    follower: FollowerParams = field(default_factory=FollowerParams)
    link: LinkParams = field(default_factory=LinkParams)
    wire: WireParams = field(default_factory=WireParams)
    contact_model: ContactModelParams = field(default_factory=ContactModelParams)
    laws: tuple[tuple[str, Any], ...] = ()
    """The laws' own sections that differ from their defaults, by name; a law's file defines its section."""
    sources: Sources = field(default=(), compare=False)
    given: frozenset[str] = field(default=frozenset(), init=False)
    """The names of all values with a source. Two `Params` are equal if their values and these names are equal."""

    def __repr__(self) -> str:
        """Return text that makes the same parameters from the defaults."""
        changed = self.changes()
        return f"Params().set({changed!r})" if changed else "Params()"

    def __post_init__(self) -> None:
        for section in fields(self):
            if section.default is MISSING and not isinstance(getattr(self, section.name), _made(section)):
                kind = _made(section)
                example = f"{section.name}.{fields(kind)[0].name}"
                allowed = f'a {kind.__name__}, or its parameters one by one: Params().set({{"{example}": ...}})'
                raise InvalidParameter(section.name, getattr(self, section.name), allowed)
        object.__setattr__(self, "laws", tuple(sorted((name, one) for name, one in self.laws if one != type(one)())))
        known = dict(self.sources)
        for name, value, spec in chain(leaves(self), *(leaves(one, f"{name}.") for name, one in self.laws)):
            check_kind(name, value, str(spec.type))
            check_allowed(name, value, spec.metadata["allowed"])
            if name not in known and value != spec.default:
                known[name] = PROGRAM
        for name in set_by_hand(self):
            known.setdefault(name, PROGRAM)
        object.__setattr__(self, "sources", tuple(sorted(known.items())))
        object.__setattr__(self, "given", frozenset(known))
        if self.world.step_min_s > self.world.step_max_s:
            raise InvalidParameter("world.step_min_s", self.world.step_min_s, "at most world.step_max_s")

    def get(self, name: str) -> Any:
        """The parameter with a dotted name."""
        value: Any = self
        for part in name.split("."):
            value = getattr(value, part)
        return value

    def source(self, name: str) -> str:
        """The source of the parameter with this dotted name: a constant of `hapnet.param_sources`."""
        return dict(self.sources).get(name, DEFAULT)

    def asked(self, name: str) -> bool:
        """Whether the user set this parameter, so that no other value may replace it."""
        return self.source(name) in ASKED

    def require(self, name: str, used: object, allowed: str) -> None:
        """Raise InvalidParameter if the user set this parameter to another value than `used`."""
        if self.asked(name) and self.get(name) != used:
            raise InvalidParameter(name, self.get(name), allowed)

    def of(self, kind: type[LawSection]) -> LawSection:
        """A law's own parameters, by their class."""
        return next((section for _, section in self.laws if type(section) is kind), kind())

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """The section of a law, or a parameter or section by its former name."""
            if name in RENAMED:
                return getattr(self, RENAMED[name])
            if name.startswith("_") or name not in (found := self.law_sections()):
                raise AttributeError(name)
            return found[name]

    def law_sections(self) -> dict[str, Any]:
        """The laws' own sections by name: those of hapnet's laws and of `coupling`, and any others that were set."""
        kinds = dict(sections())
        with suppress(InvalidParameter):  # the code that uses the coupling reports the error
            kinds |= sections_of(self.coupling)
        return {name: kind() for name, kind in kinds.items()} | dict(self.laws)

    def leaves(self) -> Iterator[tuple[str, Any, Field[Any]]]:
        """(dotted name, value, field) of every parameter."""
        yield from leaves(self)
        for name, section in self.law_sections().items():
            yield from leaves(section, f"{name}.")

    def set(self, changes: Mapping[str, object], source: str | Mapping[str, str] = PROGRAM) -> Params:
        """A copy with these parameters set. Names are dotted; values have TOML's types, or are text from `--set`.

        source : the source of these values, a constant of `hapnet.param_sources`; or the source of each by its name.

        Raises InvalidParameter: there is no such parameter, or the value is not of its type, or is not allowed.
        """
        tree: dict[str, Any] = {}
        if not isinstance(changes, Mapping) or not all(isinstance(name, str) for name in changes):
            raise InvalidParameter("changes", changes, 'names and values, such as {"duration_s": 5}')
        typed = self.typed(changes)
        known = dict(self.sources)
        by = {} if isinstance(source, str) else {present_name(name): one for name, one in source.items()}
        for name, value in typed.items():
            if isinstance(source, str) and source in RESOLVED and name in known and self.get(name) == value:
                continue  # the chosen value is the one that was set already
            known[name] = source if isinstance(source, str) else by.get(name, PROGRAM)
        tree["sources"] = tuple(known.items())
        for name, value in typed.items():
            *path, last = name.split(".")
            branch = tree
            for part in path:
                branch = branch.setdefault(part, {})
            branch[last] = value
        own: dict[str, Any] = {name: tree.pop(name) for name in tree.keys() - _SECTIONS}
        if own:
            now = self.law_sections()
            if not now.keys() >= own.keys():
                now |= self._sections_for(changes)
            laws = dict(self.laws) | {name: replaced(now[name], values) for name, values in own.items()}
            tree["laws"] = tuple(laws.items())
        changed: Params = replaced(self, tree)
        return changed

    def unset(self, *names: str) -> Params:
        """A copy in which these parameters are not set. Raises InvalidParameter: there is no such parameter."""
        defaults = {name: spec.default for name, _, spec in self.leaves()}
        changed = self.set({name: defaults.get(name) for name in names})
        kept = tuple((name, source) for name, source in changed.sources if name not in names)
        return dataclasses.replace(changed, sources=kept)

    def typed(self, changes: Mapping[str, object]) -> dict[str, Any]:
        """The values as `set` would store them: each has its parameter's type, but may be out of range.

        Raises InvalidParameter: there is no such parameter, or the value is not of its type.
        """
        changes = {present_name(name): value for name, value in changes.items()}
        known = {name: (value, spec) for name, value, spec in leaves(self)}
        if not known.keys() >= changes.keys():  # only then are laws loaded
            known = {name: (value, spec) for name, value, spec in self.leaves()}
        if not known.keys() >= changes.keys():
            for name, section in self._sections_for(changes).items():
                known |= {name: (value, spec) for name, value, spec in leaves(section, f"{name}.")}
        values = {}
        for name, value in changes.items():
            if name not in known:
                raise InvalidParameter("parameter", name, "a parameter of --show-params", known)
            values[name] = converted(name, value, *known[name])
        return values

    def _sections_for(self, changes: Mapping[str, object]) -> dict[str, Any]:
        """The sections of laws of other packages, or of the user, to which these changes apply."""
        prefixes = {name.partition(".")[0] for name in changes}
        named = [name for name in published(GROUP) if name.replace("-", "_") in prefixes]
        found = sections_of(str(changes.get("coupling", self.coupling)), *named)
        return {name: kind() for name, kind in found.items()} | dict(self.laws)

    @classmethod
    def recorded(cls, flat: Mapping[str, object], sources: object = None) -> Params:
        """The parameters of a recording. Parameters newer than the recording get the values that were in effect then.

        Parameters of a law that is not installed here are left out. sources : from the recording; None, as in older
        recordings: every value that differs from the default was set.

        Raises InvalidParameter: as `set`.
        """
        with permitting(only_imported):  # the recording may name any module
            return cls._recorded(flat, sources)

    @classmethod
    def _recorded(cls, flat: Mapping[str, object], sources: object) -> Params:
        flat = {present_name(name): value for name, value in flat.items()}
        plain = cls().set({"coupling": flat.get("coupling", cls.coupling)})
        sections = {name.partition(".")[0] for name in plain.flat()}
        known = {name: value for name, value in flat.items() if "." not in name or name.partition(".")[0] in sections}
        if plain.coupling in COUPLING_NAMES and not built_in(plain.coupling).takes_positions:
            known["rendering"] = (
                "paper" if known.get("rendering", "paper") == "paper" else "auto"
            )  # then "hapnet" was the default of every law
        by = {}
        if sources is not None:
            with suppress(InvalidParameter):  # a later version may have other sources
                by = read_sources(sources)
        defaults = {name: spec.default for name, _, spec in plain.leaves()}
        values = plain.typed({**_BEFORE, **known})
        found = {name: value for name, value in values.items() if name in by or value != defaults[name]}
        return cls().set(found, {name: by.get(name, RECORDING) for name in found})

    def set_words(self, assignments: Iterable[str]) -> Params:
        """`set` from texts such as ``world.wall.stiffness=30000``."""
        changes = {}
        for word in assignments:
            name, equals, value = word.partition("=")
            if not equals:
                raise InvalidParameter("--set", word, "NAME=VALUE, such as world.wall.stiffness=30000")
            changes[name.strip()] = value.strip()
        return self.set(changes, FLAG)

    def load(self, file: Path) -> Params:
        """A copy changed by a TOML file. A file with sources, as `toml` writes them, replaces all parameters.

        Raises InvalidParameter: it cannot be read, or has an unknown name.
        """
        try:
            table = read_toml(file)
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise InvalidParameter("--params", str(file), f"a TOML file ({why})") from None
        if "sources" not in table:
            return self.set(dict(flatten(table)), FILE)
        by = read_sources(table.pop("sources"))
        changes = {present_name(name): value for name, value in flatten(table)}
        return Params().set({name: value for name, value in changes.items() if name in by}, by)

    def changes(self) -> dict[str, Any]:
        """The values that were set, by dotted names: ``Params().set(params.changes(), dict(params.sources))`` equals
        `params`.
        """
        all_leaves = self.leaves() if self._given_of_laws() else leaves(self)  # only then are laws loaded
        return {name: value for name, value, _ in all_leaves if name in self.given}

    def _given_of_laws(self) -> frozenset[str]:
        """The names of the laws' own parameters that were set."""
        return self.given - {name for name, *_ in leaves(self)}

    def flat(self) -> dict[str, Any]:
        """Every parameter under its dotted name, whether it is set or not."""
        return {name: value for name, value, _ in self.leaves()}

    def as_dict(self) -> dict[str, Any]:
        """Return the values for a recording, nested by sections; of the laws' sections only that of `coupling`, and
        those with values that were set.
        """
        kinds: Mapping[str, type[Any]] = {}
        with suppress(InvalidParameter):  # the code that uses the coupling reports the error
            kinds = sections_of(self.coupling)
        own = {name: kind() for name, kind in kinds.items()} | dict(self.laws)
        if missing := {name.partition(".")[0] for name in self._given_of_laws()} - own.keys():  # set to the default
            own |= {name: section for name, section in self.law_sections().items() if name in missing}
        return nested(self) | {name: nested(section) for name, section in own.items()}

    def described(self) -> Iterator[tuple[str, str, str]]:
        """Dotted name, value in TOML, and meaning with unit of every parameter."""
        for name, value, spec in self.leaves():
            allowed = spec.metadata["allowed"]
            choice = "" if isinstance(allowed, Range) else f" ({' | '.join(allowed)})"
            yield name, toml_value(value), f"{spec.metadata['doc']}{choice}"

    def toml(self, *, sources: bool = False) -> str:
        """All parameters as TOML with their meanings: `--show-params` prints it and `--params` reads it.

        Values that were not set are commented out. sources : append a table with the source of each value that was
        set, for another process that reads the text by `load`.
        """
        lines = ["# Commented out: not set; a scene, a device or a rule may replace this default."]
        section = ""
        by = dict(self.sources)
        for name, value, meaning in self.described():
            prefix, _, last = name.rpartition(".")
            if prefix != section:
                lines.extend(["", f"[{prefix}]"])
                section = prefix
            entry = f"{last} = {value}" if name in by else f"# {last} = {value}"
            lines.append(f"{entry:<32} # {meaning}" + (f"; set by: {by[name]}" if name in by else ""))
        if sources:
            lines.extend(["", "[sources]", *(f"{toml_value(name)} = {toml_value(by[name])}" for name in by)])
        return "\n".join(lines) + "\n"


_SECTIONS = {one.name for one in fields(Params)}

RELAXED_HAND: Mapping[str, float] = MappingProxyType(
    {"operator_model.mass": 0.1, "operator_model.damping": 0.5, "operator_model.stiffness": 40.0}
)
"""A hand that holds the handle loosely [kg, Ns/m, N/m]: it damps vibrations less than a firm hand does."""


def _made(section: Field[Any]) -> type[Any]:
    """The class of a section, which is its default's factory."""
    made: Any = section.default_factory
    return cast(type[Any], made)


def as_params(given: Params | Mapping[str, object]) -> Params:
    """These parameters, or the defaults with these changes by dotted names. Raises InvalidParameter."""
    if isinstance(given, Mapping):
        given = Params().set({str(name): value for name, value in given.items()})
    if not isinstance(given, Params):
        raise InvalidParameter("params", given, 'a Params, or changes such as {"link.up": "4g", "link.down": "4g"}')
    return given
