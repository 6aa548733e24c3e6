"""The Inverse Service's messages, against documents written by hand after the maker's pages for 3.5 and 3.1."""

import json
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from hapnet.ext.devices import inverse3_messages as wire

INVENTORY = b"""{
  "session_id": 7,
  "inverse3": [{
    "device_id": "049D",
    "config": {"type": "inverse3", "handedness": "right", "preset": "defaults", "basis": {"permutation": "XYZ"}},
    "state": {
      "cursor_position": {"x": 0.01, "y": -0.12, "z": 0.15},
      "cursor_velocity": {"x": 0.0, "y": 0.5, "z": 0},
      "angular_position": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
      "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
      "current_cursor_force": {"x": 0.0, "y": 0.0, "z": 0.0},
      "control_domain": "cartesian", "control_mode": "idle"
    },
    "status": {"calibrated": true, "in_use": false, "power_supply": true, "ready": true, "started": true}
  }],
  "wireless_verse_grip": [{
    "device_id": "61576",
    "state": {"orientation": {"w": 0.8, "x": 0.0, "y": 0.6, "z": 0.0}, "buttons": {"a": false, "b": true, "c": false}}
  }]
}"""


def inventory(**changes: Any) -> dict[str, Any]:
    """The inventory with these entries of its arm's state."""
    message: dict[str, Any] = json.loads(INVENTORY)
    message["inverse3"][0]["state"].update(changes)
    return message


def state_in(message: dict[str, Any]) -> wire.Inverse3State:
    state = wire.state(message, "049D")
    assert state is not None
    return state


def test_an_inventory_is_read() -> None:
    message = wire.parsed(INVENTORY)
    assert message is not None
    assert wire.arms(message) == ["049D"]
    assert wire.state(message, "049D") == wire.Inverse3State(
        position=(0.01, -0.12, 0.15),
        velocity=(0.0, 0.5, 0.0),
        calibrated=True,
        powered=True,
        buttons=(False, True, False),
        orientation=(0.8, 0.0, 0.6, 0.0),
        force=(0.0, 0.0, 0.0),
        grip="61576",
    )
    assert wire.state(message, "06DA") is None


def test_a_wired_grip_has_one_button() -> None:
    message = inventory()
    turned = {"w": 0.0, "x": 1.0, "y": 0.0, "z": 0.0}
    del message["wireless_verse_grip"]
    message["verse_grip"] = [{"device_id": "1", "state": {"button": True, "hall": 1, "orientation": turned}}]
    state = state_in(message)
    assert (state.buttons, state.orientation) == ((True,), (0.0, 1.0, 0.0, 0.0))


def test_without_grip_and_status_there_is_a_state_all_the_same() -> None:
    message = inventory()
    del message["wireless_verse_grip"]
    del message["inverse3"][0]["status"]
    state = state_in(message)
    assert (state.calibrated, state.powered, state.buttons, state.orientation) == (True, True, (), None)


@pytest.mark.parametrize("flag", ["calibrated", "power_supply"])
def test_the_status_is_read(flag: str) -> None:
    message = inventory()
    message["inverse3"][0]["status"][flag] = False
    state = state_in(message)
    assert (state.calibrated, state.powered) == (flag != "calibrated", flag != "power_supply")


@pytest.mark.parametrize(
    "position",
    [
        None,
        [0.1, 0.2, 0.3],
        {"x": 0.1, "y": 0.2},
        {"x": "0.1", "y": 0.2, "z": 0.3},
        {"x": True, "y": 0.2, "z": 0.3},
        {"x": float("nan"), "y": 0.2, "z": 0.3},
        {"x": float("inf"), "y": float("-inf"), "z": 0.3},
        {"x": 10**400, "y": 0.2, "z": 0.3},
    ],
)
@pytest.mark.parametrize("which", ["cursor_position", "cursor_velocity"])
def test_what_is_no_vector_is_no_state(which: str, position: object) -> None:
    message = wire.parsed(json.dumps(inventory(**{which: position})).encode())
    assert message is not None
    assert wire.state(message, "049D") is None


@pytest.mark.parametrize("length", [0.9, 1.1, 0.0])
def test_what_is_no_unit_quaternion_is_no_orientation(length: float) -> None:
    message = inventory()
    message["wireless_verse_grip"][0]["state"]["orientation"] = {"w": length, "x": 0.0, "y": 0.0, "z": 0.0}
    assert state_in(message).orientation is None


def test_a_quaternion_of_few_digits_becomes_a_unit_one() -> None:
    message = inventory()
    message["wireless_verse_grip"][0]["state"]["orientation"] = {"w": 0.71, "x": 0.0, "y": 0.71, "z": 0.0}
    assert state_in(message).orientation == pytest.approx((0.5**0.5, 0.0, 0.5**0.5, 0.0))


@pytest.mark.parametrize("spelling", ["vector", "values"])
def test_a_command_is_as_documented(spelling: str) -> None:
    assert json.loads(wire.command("049D", (0.0, -0.25, 1e-7), spelling)) == {
        "inverse3": [
            {"device_id": "049D", "commands": {"set_cursor_force": {spelling: {"x": 0.0, "y": -0.25, "z": 1e-7}}}}
        ]
    }


def test_the_first_message_is_as_documented() -> None:
    assert json.loads(wire.greeting('04"9D', "arm_front_centered")) == {
        "session": {"configure": {"profile": {"name": "hapnet"}, "basis": {"permutation": "XYZ"}}},
        "inverse3": [
            {
                "device_id": '04"9D',
                "configure": {"preset": {"preset": "arm_front_centered"}},
                "commands": {"set_cursor_force": {"vector": {"x": 0.0, "y": 0.0, "z": 0.0}}},
            }
        ],
    }


def test_the_second_message_asks_for_the_configuration() -> None:
    asked = json.loads(wire.whole("049D", "values", "minverse"))
    assert asked["session"] == {"force_render_full_state": {}}
    assert asked["minverse"][0]["commands"] == {"set_cursor_force": {"values": {"x": 0.0, "y": 0.0, "z": 0.0}}}


@pytest.mark.parametrize(("config", "preset"), [
    ({"preset": "arm_front"}, "arm_front"), ({"preset": {"preset": "arm_front"}}, "arm_front"), ({}, None), (3, None),
    ({"preset": 4}, None),
])  # fmt: skip
def test_the_preset_is_read_back(config: Any, preset: str | None) -> None:
    message = inventory()
    message["inverse3"][0]["config"] = config
    assert wire.preset_of(message, "049D") == preset
    assert wire.preset_of(message, "06DA") is None


def test_a_service_before_3_5_says_values_and_has_no_number_for_the_session() -> None:
    """Its inventory, as the pages of 3.4 print it, has neither a session's number nor a preset."""
    message = inventory()
    message["inverse3"][0]["config"] = {"type": "inverse3"}
    assert wire.spelling_of({"session_id": 7, **message}, "049D") == "vector"
    del message["session_id"]
    assert wire.spelling_of(message, "049D") == "values"


@pytest.mark.parametrize("flag", ["awake", "connected", "ready"])
def test_a_grip_that_is_not_healthy_has_its_buttons_released(flag: str) -> None:
    message = inventory()
    message["wireless_verse_grip"][0]["status"] = {"awake": True, "connected": True, "ready": True}
    assert state_in(message).buttons == (False, True, False)
    message["wireless_verse_grip"][0]["status"][flag] = False
    state = state_in(message)
    assert (state.buttons, state.orientation) == ((False, False, False), None)


def test_a_minverse_is_named_as_such() -> None:
    message = inventory()
    message["minverse"] = message.pop("inverse3")
    assert wire.kind_of(message, "049D") == "minverse"
    assert json.loads(wire.command("049D", (0.0, 0.0, 0.0), kind="minverse"))["minverse"][0]["device_id"] == "049D"


def test_events_are_read() -> None:
    brake = b"""{"name": "device-safety-triggered", "category": "device", "level": "error",
        "data": {"device_family": "inverse", "device_id": "049D", "safety_type": "ebrake_triggered"}, "message": "-"}"""
    assert wire.notice(brake) == wire.ForceEvent("ebrake_triggered", "049D", "error")
    plain = b'{"name": "device-connected", "category": "device", "level": "info", "data": {}, "message": ""}'
    assert wire.notice(plain) == wire.ForceEvent("device-connected", "", "info")
    assert wire.notice(b'{"name": 3, "data": []}') is None


NAMES = [
    "inverse3", "device_id", "state", "status", "cursor_position", "cursor_velocity", "x", "y", "z", "name", "data",
    "wireless_verse_grip", "verse_grip", "buttons", "button", "orientation", "safety_type",
]  # fmt: skip
JSON: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(NAMES), inner),
    max_leaves=10,
)


def test_what_is_nested_too_deeply_is_no_message() -> None:
    assert wire.parsed(b"[" * 100_000) is None


@settings(max_examples=50)
@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_rubbish_is_never_a_state_and_never_an_error(raw: bytes) -> None:
    wire.notice(raw)
    if (message := wire.parsed(raw)) is not None:
        wire.arms(message)
        assert wire.state(message, "049D") is None


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, len(INVENTORY) - 1), st.integers(0, 255)), min_size=1, max_size=3))
def test_a_damaged_state_is_three_finite_numbers_or_none(damage: list[tuple[int, int]]) -> None:
    raw = bytearray(INVENTORY)
    for place, byte in damage:
        raw[place] = byte
    if (message := wire.parsed(bytes(raw))) is not None and (state := wire.state(message, "049D")) is not None:
        assert all(type(part) is float and abs(part) < float("inf") for part in (*state.position, *state.velocity))
