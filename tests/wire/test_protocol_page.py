"""The protocol's page says what the code does: its table of constants, and the keys that it names."""

import re
from pathlib import Path
from typing import get_args

import pytest

from hapnet.control import deadband
from hapnet.couplings.registry import COUPLINGS
from hapnet.params import Params
from hapnet.realtime import reporter
from hapnet.transport import keys, probe, zenoh
from hapnet.wire import (
    account,
    control_sender,
    energy_channel,
    handshake,
    messages,
    numbering,
    peer_monitor,
    replay_window,
    rto,
    signals,
)
from hapnet.wire.messages import Message
from hapnet.wire.session import SessionSettings

PAGE = (Path(messages.__file__).parent / "README.md").read_text("utf-8")
MS = 1_000_000
DEFAULT = SessionSettings()

CODE: dict[str, float] = {
    "hello period [ms]": DEFAULT.hello_period_ns / MS,
    "minimum time between two hellos caused by strangers [ms]": control_sender.PROMPT_NS / MS,
    "a peer is living for [ms]": peer_monitor.LIVING_NS / MS,
    "wait for a silent candidate [ms]": handshake.CANDIDATE_NS / MS,
    "longest wait for a candidate [ms]": handshake.CANDIDATURE_NS / MS,
    "silence that is reported [ms]": DEFAULT.silence_ns / MS,
    "replies (welcomes, refusals) at once": control_sender.MAX_REPLIES,
    "time between two rounds of replies [ms]": control_sender.REPLY_SPACING_NS / MS,
    "copies of a bye": control_sender.BYE_COPIES,
    "time between them [ms]": control_sender.BYE_SPACING_NS / MS,
    "peers in one process's life": handshake.MAX_PEERS,
    "minimum time between two messages with new energy [ms]": DEFAULT.spacing_ns / MS,
    "an acknowledgement waits [ms]": energy_channel.ACK_DELAY_NS / MS,
    "retransmission timer, first value [ms]": rto.INITIAL_NS / MS,
    "retransmission timer, floor [ms]": rto.FLOOR_NS / MS,
    "retransmission timer, ceiling [ms]": rto.CEILING_NS / MS,
    "retransmission timer, granularity [ms]": rto.GRANULARITY_NS / MS,
    "bucket, power [W]": DEFAULT.admission_W,
    "bucket, burst [J]": DEFAULT.admission_burst_J,
    "frame, maximum [bytes]": messages.MAX_FRAME_BYTES,
    "waves, window": replay_window.WINDOW,
    "numbers ahead at once": numbering.MOST_AT_ONCE,
    "time that each further number takes [ms]": numbering.MIN_PERIOD_NS / MS,
    "early by [ms]": numbering.EARLY_NS / MS,
    "flood limit [a second]": zenoh.MOST_HZ,
    "flood limit, at once": zenoh.MOST_AT_ONCE,
    "a stream with a deadband sends at least every [ms]": deadband.MAX_S * 1e3,
    "keep-alive on a quiet key, at least every [ms]": keys.KEEP_ALIVE_NS / MS,
    "a silent key is subscribed to again after [ms]": keys.SILENT_NS / MS,
    "minimum time between two frames of signals [ms]": signals.SPACING_NS / MS,
    "signals are repeated every [ms]": signals.REPEAT_NS / MS,
    "an account is sent every [ms]": reporter.EVERY_NS / MS,
    "minimum time between two accounts at the end [ms]": reporter.AT_THE_END_NS / MS,
    "an account that is not answered is repeated every [ms]": account.REPEAT_NS / MS,
    "telemetry [Hz]": 60.0,
    "probes that are answered [a second]": probe.MOST_HZ,
}


def table() -> dict[str, tuple[float, list[str]]]:
    """What the page's table says: its value, and the parameters that set it."""
    section = PAGE.partition("## Constants")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| ([^|]+) \| ([0-9.]+) ?([^|]*?) \|\s*([^|]*?)\s*\|$", section, re.MULTILINE)
    return {
        f"{what} [{unit}]" if unit else what: (float(value), re.findall(r"`([^`]+)`", names))
        for what, value, unit, names in rows
    }


def test_the_table_has_every_constant_and_no_other() -> None:
    assert {what: value for what, (value, _) in table().items()} == pytest.approx(CODE)


def test_what_may_be_set_is_a_parameter_with_that_default() -> None:
    scale = {"ms": 1e3, "W": 1.0, "J": 1.0, "Hz": 1.0}
    found = 0
    for what, (value, names) in table().items():
        for name in names:
            default = Params().get(name)
            assert default * scale[what.partition("[")[2].rstrip("]")] == pytest.approx(value), name
            found += 1
    assert found >= 7


def test_both_sides_count_the_same_silence() -> None:
    """A session of its own has one default for it, the parameters have one a side."""
    assert Params().device.silence_after_s == Params().world.silence_after_s


def test_the_limits_in_the_text_are_the_codes() -> None:
    text = " ".join(PAGE.split())
    assert f"at most {messages.MAX_FRAME_BYTES} bytes" in text
    assert f"**the protocol, version {messages.VERSION}" in "**" + text[2:].lower()
    assert f"until {numbering.PROOF} new ones" in text
    assert f"first {numbering.PROOF} new ones have come, {numbering.LATE_RUN} late ones in a row over 0.1 s" in text
    assert numbering.LATE_RUN_NS == 100 * MS
    assert f"by {numbering.EARLY_NS // MS} ms and twice the mean excess" in text
    assert f"known once {numbering.WARM} have come" in text
    assert (numbering.RUN, numbering.WINDOW_NS) == (2, 10_000 * MS)
    assert f"{zenoh.MOST_HZ:,} messages a second, of which {zenoh.MOST_AT_ONCE:,} may" in text
    assert f"any payload of 1 to {probe.MAX_LENGTH} bytes" in text
    for kind in (*zenoh.KINDS, probe.PROBE, zenoh.TELEMETRY):
        assert kind in text


@pytest.mark.parametrize("message", get_args(Message), ids=lambda m: m.__name__.lower())
def test_the_page_names_the_elements_of_each_frame_in_their_order(message: type[Message]) -> None:
    frames = PAGE.partition("| kind | elements 4 and following |")[2].partition("\n\n")[0]
    (row,) = re.findall(rf"^\| {message.__name__.lower()} \| (.*) \|$", frames, re.MULTILINE)
    own = [name for name in message.__struct_fields__[1:] if name != "more"]  # every frame may have further entries
    assert [name for name in re.findall(r"`(\w+)`", re.sub(r"array of `dof`", "", row)) if name in own] == own
    kinds = PAGE.partition("| kind | message |")[2].partition("\n\n")[0]
    assert re.search(rf"^\| {message.KIND} \| {message.__name__.lower()} \| {message.CHANNEL} \|", kinds, re.MULTILINE)


def test_the_page_names_the_streams_of_each_coupling() -> None:
    section = PAGE.partition("| coupling | device to world | world to device |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| (`.*`) \| (\w+).* \| (\w+).* \|$", section, re.MULTILINE)
    reported = {name: (up, down) for names, up, down in rows for name in re.findall(r"`([^`]+)`", names)}
    sent = {name: tuple(spec.sends(role, Params()) for role in ("device", "world")) for name, spec in COUPLINGS.items()}
    assert reported == {name: (up.__name__.lower(), down.__name__.lower()) for name, (up, down) in sent.items()}
