"""What the driver of the Inverse3 makes of what its service reports beside positions: frames, risks, grips, forces."""

import pytest

from hapnet.errors import DeviceSilent, HapnetError
from hapnet.ext.devices.inverse3 import Inverse3
from tests.devices import test_inverse3
from tests.devices.test_inverse3 import Service, report, tick

service = test_inverse3.service


@pytest.mark.parametrize(("name", "why"), [
    ("stability_ceiling", "its stability ceiling is reached"), ("fod_stage_changed", "its service reports a high risk"),
])  # fmt: skip
def test_what_the_service_sees_as_a_risk_takes_the_force_away(service: Service, name: str, why: str) -> None:
    driver = Inverse3(1)
    driver.read()
    report(driver, name)
    tick(service, driver, (1.0,))
    assert why in driver.braked()
    assert service.force == (0.0, 0.0, 0.0)
    if name == "fod_stage_changed":
        report(driver, name, level="info")
    else:
        service.now_s += 1.0
    tick(service, driver, (1.0,))
    assert driver.braked() == ""


def test_an_arm_that_is_gone_renders_no_force_until_it_is_back(service: Service) -> None:
    driver = Inverse3(1)
    driver.read()
    report(driver, "", name="device-disconnected")
    tick(service, driver, (1.0,))
    assert driver.braked() == "it is disconnected"
    report(driver, "", name="device-connected")
    tick(service, driver, (1.0,))
    assert driver.braked() == ""


def test_a_grip_that_falls_asleep_lets_its_buttons_go(service: Service) -> None:
    state = {"buttons": {"a": True, "b": False}, "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}}
    service.grips = [{"device_id": "61576", "state": state}]
    driver = Inverse3(1)
    driver.read()
    assert driver.buttons() == (True, False)
    report(driver, "", "61576", name="device-sleep")
    tick(service, driver, (0.0,))
    assert driver.buttons() == (False, False)
    assert driver.braked() == ""


def test_a_frame_that_is_not_what_was_asked_for_is_refused(service: Service) -> None:
    service.ignores = True
    driver = Inverse3(1)
    with pytest.raises(HapnetError, match="did not put the arm 049D at arm_front_centered: it has it at defaults"):
        driver.home()
    Inverse3(1, preset="defaults").home()


def test_a_frame_that_changes_when_the_service_comes_back_ends_the_run(service: Service) -> None:
    driver = Inverse3(1)
    driver.home()
    driver.apply((0.0,))
    service.listens = False
    for _ in range(5):
        with pytest.raises(DeviceSilent):
            driver.read()
        with pytest.raises(DeviceSilent):
            driver.apply((0.0,))
    service.listens = service.ignores = True
    service.preset = "defaults"
    with pytest.raises(HapnetError, match="put the arm 049D at defaults, not at arm_front_centered"):
        driver.read()


def test_a_service_that_takes_no_forces_is_named(service: Service) -> None:
    service.deaf = True
    driver = Inverse3(1)

    def press() -> None:
        for _ in range(100):
            tick(service, driver, (0.3,))

    with pytest.raises(HapnetError, match="accepts no force for the arm 049D: its current_cursor_force stayed 0"):
        press()


def test_a_minverse_has_its_own_reach_and_name(service: Service) -> None:
    service.kind = "minverse"
    driver = Inverse3(1)
    driver.home()
    assert driver.workspace == 0.04
    driver.apply((1.0,))
    assert service.force == (1.0, 0.0, 0.0)
