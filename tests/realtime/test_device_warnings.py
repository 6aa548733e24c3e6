"""What a device warns of while it is made reaches the user, in a thread and in the servo's own process."""

import subprocess
import sys

import pytest

from hapnet.assembly.build import device_session, prepare
from hapnet.params import Params
from hapnet.realtime.controllers import ControlCallbacks
from hapnet.realtime.runner import RealtimeSide
from hapnet.realtime.servo_pipe import Pipe, socket_pair
from hapnet.realtime.servo_process import ServoProcess
from hapnet.recording.samples import Event, Sample
from hapnet.side.notices import Notice
from hapnet.transport.config import ZenohSettings

LIGHT = {"scene": "free", "hardware": "tests.assembly.test_user_device:Light"}
"""A device of 1 g that goes 5 m/s: the default ceiling is too low for it."""


def test_in_a_thread() -> None:
    """A side of such a device could not be made at all: the reporter came after the device."""
    setup = prepare(Params().set(LIGHT), "sampled")
    notices: list[Notice] = []
    side = RealtimeSide(setup, "device", ZenohSettings(connect=("tcp/127.0.0.1:1",)), notify=notices.append)
    side._reporter.report_notes()
    assert [notice.kind for notice in notices] == ["warning"]
    assert "at up to 5 m/s" in notices[0].text


def test_what_the_first_tick_tells_may_come_before_the_servo_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    """A button's state that came first was taken for an error."""
    setup = prepare(Params().set(LIGHT), "sampled")
    servo = ServoProcess(setup, device_session(setup, 7), ControlCallbacks(print, print, print, lambda: None))
    ours, theirs = map(Pipe, socket_pair())

    def open_ours() -> None:
        servo._pipe, servo._process = ours, subprocess.Popen([sys.executable, "-c", ""])

    monkeypatch.setattr(servo, "_open", open_ours)
    assert theirs.offer("signal", "buttons", (True,))
    assert theirs.offer("ready", None)
    try:
        assert servo.start() is None
        assert servo.reported() == ("buttons", (True,))
    finally:
        theirs.close()
        servo.stop()


def test_in_a_process_of_its_own() -> None:
    """The warning came before the word that the servo runs, and was taken for an error."""
    setup = prepare(Params().set(LIGHT), "sampled")
    reported: list[Sample] = []
    servo = ServoProcess(setup, device_session(setup, 7), ControlCallbacks(print, reported.append, print, print))
    try:
        servo.start()
    finally:
        servo.stop()
    assert [sample.kind for sample in reported if isinstance(sample, Event)] == ["warning"]
