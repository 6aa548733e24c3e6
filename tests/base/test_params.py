"""Parameters: TOML there and back, `--set`, and one clear line for what is wrong."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from hapnet.couplings.registry import coupling
from hapnet.errors import InvalidParameter
from hapnet.laws import COUPLING_NAMES
from hapnet.param_schema import schema
from hapnet.param_sources import FILE
from hapnet.param_values import Range, toml_value
from hapnet.params import Params

AGREED = Path(__file__).parents[1] / "data" / "parameters.toml"
"""Every parameter's default and what it may be; then among what a tuning of each law searches."""


def test_shown_parameters_read_back_to_the_same(tmp_path: Path) -> None:
    changed = Params().set_words(
        ["world.wall.stiffness=30000", "device.stiffness=[[100, 5], [5, 80]]", "scene=box", "wire.accept_stale=true"]
    )
    file = tmp_path / "p.toml"
    file.write_text(changed.toml(), encoding="utf-8")
    assert Params().load(file) == changed
    assert changed.world.wall.stiffness == 30000.0


def test_defaults_are_section_4s() -> None:
    """But for the device's stiffness, 100 N/m there, that a rule chooses."""
    p = Params()
    assert (p.device.stiffness, p.device.damping, p.world.stiffness, p.world.damping) == (0.0, 0.1, 500.0, 14.0)
    assert (p.world.mass, p.world.wall.stiffness, p.world.wall.damping) == (0.02, 3000.0, 10.0)
    assert (p.device.servo_hz, p.device.pspm_period_s) == (1000.0, 0.005)
    assert (p.world.step_min_s, p.world.step_max_s) == (0.01, 0.05)


def test_defaults_and_what_is_allowed_change_on_purpose_only() -> None:
    """Recordings and users rely on them; whoever changes one changes the list too."""
    lines = []
    for name, value, spec in Params().leaves():
        allowed = spec.metadata["allowed"]
        lines.append(f"{name} = {toml_value(value)}  # {'' if allowed == Range() else allowed}".rstrip(" #"))
    for law in COUPLING_NAMES:
        lines.extend(f"# {law} searches {name}: {values}" for name, values in coupling(law).searched.items())
    assert lines == AGREED.read_text("utf-8").splitlines()


@pytest.mark.parametrize(
    ("word", "names"),
    [
        ("world.wal.stiffness=1", "world.wall.stiffness"),
        ("dof=1.5", "whole number"),
        ("device.servo=fast", "continuous"),
        ("duration_s", "NAME=VALUE"),
        ("world.step_min_s=3", "step_max_s"),
        ("world.mass=-1", "above 0"),
        ("device.smoothing_s=-1", "0 or above"),
        ("wire.accept_stale=1", "true or false"),
        ("device.servo_hz=[1]", "a number"),
        ("device.servo_hz=NaN", "finite"),
        ("duration_s=Infinity", "finite"),
        ("device.servo_hz=1e9", "20000"),
        ("device.spring_share=1.5", "device.spring_share is 1.5; allowed: a number above 0, at most 1"),
        ("wire.hello_period_s=100", "wire.hello_period_s is 100.0; allowed: 0.001 to 10"),
    ],
)
def test_what_is_wrong_is_named(word: str, names: str) -> None:
    with pytest.raises(InvalidParameter, match=names.replace(".", r"\.")):
        Params().set_words([word])


@pytest.mark.parametrize(("word", "value"), [(".5", 0.5), ("-.5", -0.5), ("+.5", 0.5), ("+2", 2.0), ("1e-1", 0.1)])
def test_numbers_may_be_written_as_people_write_them(word: str, value: float) -> None:
    assert Params().set_words([f"operator_model.start_m={word}"]).operator_model.start_m == value


SIGNED = {"operator_model.start_m", "operator_model.goal_m", "world.wall.position_m"}
"""Coordinates along an axis; everything else is a size, a rate, a time or a number of something."""


def numbers(table: Mapping[str, object], prefix: str = "") -> Iterator[str]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield prefix + name


@pytest.mark.parametrize("name", list(numbers(Params().as_dict())))
def test_negative_numbers_are_refused_where_they_make_no_sense(name: str) -> None:
    if name in SIGNED:
        assert Params().set({name: -1}).get(name) == -1
        return
    with pytest.raises(InvalidParameter, match=f"^{re.escape(name)} is -1"):
        Params().set({name: -1})


@pytest.mark.parametrize(
    "text", ["\U0001f44b.csv", 'a "b" \\ c', "two\nlines\t", "\x7f\x00\x1b", "é = 'ü' # no comment", ""]
)
def test_any_text_is_written_as_toml(text: str, tmp_path: Path) -> None:
    changed = Params().set({"operator": text, "link.up": text})
    file = tmp_path / "p.toml"
    file.write_text(changed.toml(), encoding="utf-8")
    assert Params().load(file) == changed


def test_a_file_that_is_no_toml(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text("not = [toml", encoding="utf-8")
    with pytest.raises(InvalidParameter, match="TOML"):
        Params().load(file)


# -- the schema for editors --------------------------------------------------------------------------------------------

VALUES = (-1, 0, 1e-12, 0.5, 15, 10**12, "hold", "fast", True, [[1.0, 0.0], [0.0, 1.0]], [])
COUPLED = {"world.step_min_s", "world.step_max_s"}
"""Each is bounded by the other too, which a schema cannot say."""


@pytest.mark.long
def test_the_schema_takes_what_the_program_takes() -> None:
    """Of every parameter the same values, but that a schema takes no empty list; `jsonschema` is the judge."""
    jsonschema = pytest.importorskip("jsonschema", reason="the judge of schemas is not installed")
    judge = jsonschema.Draft7Validator(schema(Params()))
    judge.check_schema(judge.schema)
    tried = 0
    for name in Params().flat():
        for value in VALUES:
            if name in COUPLED and value != -1:
                continue
            *path, last = name.split(".")
            table: dict[str, object] = {last: value}
            for section in reversed(path):
                table = {section: table}
            assert judge.is_valid(table) == (value != [] and taken(name, value)), (name, value)
            tried += 1
    assert tried > 900


def taken(name: str, value: object) -> bool:
    try:
        Params().set({name: value})
    except InvalidParameter:
        return False
    return True


def test_the_schema_knows_what_is_shown_and_nothing_else() -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="the judge of schemas is not installed")
    chosen = Params().set({"device.stiffness": [[100.0, 5.0], [5.0, 80.0]], "scene": "box"})
    shown = tomllib.loads(chosen.toml())
    for params in (Params(), chosen):
        judge = jsonschema.Draft7Validator(schema(params))
        assert judge.is_valid(shown)
        assert not judge.is_valid(shown | {"stiffnes": 1.0})
        assert not judge.is_valid(shown | {"wire": {"admision_W": 1.0}})
    described = schema(chosen)["properties"]["wire"]["properties"]["admission_W"]
    assert described == {
        "description": "the most shuffled power that is credited in the long run [W]",
        "default": 5.0, "type": "number", "minimum": 1e-9, "maximum": 1e9,
    }  # fmt: skip


def test_former_names_of_parameters_are_read_with_their_sources(tmp_path: Path) -> None:
    """Files and recordings of 0.1, and `--set`; "feel" was a parameter, "operator_hand" a section."""
    expected = Params().set({"rendering": "paper", "operator_model.mass": 0.3}, FILE)
    former = {"feel": "paper", "operator_hand.mass": 0.3}
    plain, whole = tmp_path / "plain.toml", tmp_path / "whole.toml"
    plain.write_text('feel = "paper"\n[operator_hand]\nmass = 0.3\n', encoding="utf-8")
    whole.write_text(
        'feel = "paper"\n[operator_hand]\nmass = 0.3\n[sources]\n"feel" = "file"\n"operator_hand.mass" = "file"\n',
        encoding="utf-8",
    )
    for params in (
        Params().set(former, FILE),
        Params().set(former, dict.fromkeys(former, FILE)),
        Params().load(plain),
        Params().load(whole),
    ):
        assert params == expected
        assert params.sources == expected.sources
        assert params.get("operator_hand.mass") == 0.3
    recorded = Params.recorded(former, dict.fromkeys(former, FILE))
    assert (recorded.rendering, recorded.operator_model.mass) == ("paper", 0.3)
    assert recorded.source("rendering") == recorded.source("operator_model.mass") == FILE
    assert Params().set_words(["operator_hand.mass=0.3"]).operator_model.mass == 0.3
    with pytest.raises(InvalidParameter, match="operator_model"):
        Params().set({"operator_hand.mas": 0.3})
