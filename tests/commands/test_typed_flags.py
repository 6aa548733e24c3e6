"""An error names the flag that was typed; a parameter of a file or a program keeps its own name."""

import socket
import sys
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.assembly.build import prepare
from hapnet.commands.options import LinkOptions, ModelOptions, ParamsOptions
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.transport.diagnosis import check_hosts
from netem.groups import grouped
from tests.conftest import mostly_slow
from tests.support.commands import Capture, empty_directory as empty_directory

ADDRESS = "tcp/127.0.0.1:17447"

WRONG = {
    "--scene": "wal",
    "--operator": "nothere:Hand",
    "--device": "nothere:Slider",
    "--follower": "nothere:Robot",
    "--coupling": "PSMP",
    "--rendering": "papr",
    "--feel": "papr",
    "--servo": "sampling",
    "--servo-hz": "1",
    "--dof": "9",
    "--duration": "-1",
    "--on-silence": "panic",
    "--silence-after": "0",
    "--deadband": "2",
    "--link": "4G",
    "--profile": "4G",
    "--delay": "40",
    "--jitter": "10",
    "--loss": "much",
    "--resend": "3",
    "--reorder": "much",
    "--rate": "1furlong",
    "--uplink": "4G",
    "--downlink": "delay fast",
    "--timeline": "soon",
    "--up-timeline": "soon",
    "--down-timeline": "at 1s: sideways",
    "--params": "nothere.toml",
    "--set": "device.stiffness=hard",
    "--seed": "-1",
    "--json": "/",
    "--out": "/proc/no",
    "--log": "/proc/no/log",
    "--graph": "nothere.toml",
}
"""A wrong value of each flag of `hapnet run` that has a value."""


@pytest.mark.parametrize("flag", mostly_slow([(one,) for one in WRONG], 19))
def test_an_error_names_the_flag_and_its_value(flag: str, capsys: Capture, empty_directory: Path) -> None:
    for argv in ([flag, WRONG[flag]], [f"{flag}={WRONG[flag]}"]):
        assert cli.main(["run", *argv]) == 2
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        begins = (f"{flag}: ", f"{flag} ", f"unknown {flag} ", f"Invalid value for '{flag} ")
        assert line.removeprefix("hapnet: ").startswith(begins)
        assert flag == "--resend" or WRONG[flag].replace("=", " ").split()[-1] in line  # there a word is missing
        assert "hardware" not in line
    assert not list(empty_directory.iterdir())


def test_every_flag_of_a_run_is_in_the_table() -> None:
    options = [option for option in cli._command("run").params if not option.is_flag]
    assert {name for option in options for name in option.opts} == set(WRONG)


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ("run --device nothere:Slider", "cannot import module 'nothere' (is nothere.py in this directory?)"),
        ("run --device no.there:Slider", "cannot import module 'no.there' (is no/there.py in this directory?)"),
        ("run --link 4G", "--link: unknown profile '4G'; did you mean 4g?"),
        ("run --set scene=wal --scene wall", "--set: unknown scene 'wal'; did you mean wall?"),
        ("run --set scene=wal --set device.mass=1", "--set: unknown scene 'wal'; did you mean wall?"),
        (f"device -e {ADDRESS} -m boss", "-m is 'boss'; allowed: one of peer, client, router"),
        (f"device -e {ADDRESS} --mode boss", "--mode is 'boss'; allowed: one of peer, client, router"),
        (f"device --role follower --device nothere:Arm -e {ADDRESS}", "--device nothere:Arm: cannot import"),
        ("compare --coupling psmp", "unknown --coupling 'psmp'; did you mean pspm?"),
        ("doctor --device seriall", "unknown --device 'seriall'; did you mean serial?"),
        ("device -e 127.0.0.1:1", "-e is '127.0.0.1:1'"),
    ],
)
def test_what_the_error_of_a_flag_says(argv: str, says: str, capsys: Capture, empty_directory: Path) -> None:
    assert cli.main(argv.split()) == 2
    assert says in capsys.readouterr().err


def test_a_value_of_a_file_keeps_its_name(capsys: Capture, empty_directory: Path) -> None:
    Path("own.toml").write_text('hardware = "nothere:Slider"\n', "utf-8")
    assert cli.main(["run", "--params", "own.toml"]) == 2
    assert capsys.readouterr().err.startswith("hapnet: hardware nothere:Slider: cannot import module 'nothere'")
    Path("own.toml").write_text("duration_s = [1]\n", "utf-8")
    assert cli.main(["run", "--duration", "1", "--params", "own.toml"]) == 2  # the flag is right, the file is not
    assert capsys.readouterr().err.startswith("hapnet: own.toml: duration_s is [1]; allowed: a number")


def test_a_value_of_a_program_keeps_its_name() -> None:
    with pytest.raises(InvalidParameter, match=r"^hardware nothere:Slider: cannot import module 'nothere'"):
        prepare(Params().set({"hardware": "nothere:Slider"}), "sampled")


DRIVERS = """
class Unread:
    dof, force_limit, resolution = 1, 3.0, 0.0
    def __init__(self, dof): pass
    def apply(self, force): return force

class Idle(Unread):
    apply = None

class Undemanding(Unread):
    def __init__(self): pass
    def read(self): return (0.0,), (0.0,)

class Demanding(Undemanding):
    def __init__(self, dof, port): pass
"""


@pytest.mark.parametrize("flag", ["--device", "--follower"])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Unread", "the class Unread has no method read"),
        ("Idle", "the class Idle has no method read and no method apply"),
        ("Undemanding", "it cannot be made with dof=1: got an unexpected keyword argument 'dof'"),
        ("Demanding", "it cannot be made with dof=1: missing a required argument: 'port'"),
    ],
)
def test_a_wrong_driver_is_refused_before_a_process_starts(
    flag: str, name: str, says: str, capsys: Capture, empty_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapnet.commands.pair.Pair", None)
    monkeypatch.setattr(sys, "path", [*sys.path, str(empty_directory)])
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    (empty_directory / "mine.py").write_text(DRIVERS, "utf-8")
    assert cli.main(["run", flag, f"mine:{name}"]) == 2
    assert capsys.readouterr() == ("", f"hapnet: {flag} mine:{name}: {says}\n")
    assert {path.name for path in empty_directory.iterdir()} <= {"mine.py", "__pycache__"}


@pytest.mark.parametrize("command", ["device", "view", "play", "doctor", "bridge ros2"])
def test_a_host_without_an_address_is_refused_at_once(
    command: str, capsys: Capture, empty_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", _fails(socket.EAI_NONAME))
    assert cli.main([*command.split(), "-e", "tcp/no.such.host:17447"]) == 2
    assert capsys.readouterr() == ("", "hapnet: -e tcp/no.such.host:17447: no such host: no.such.host (not now)\n")
    assert not list(empty_directory.iterdir())


def test_a_look_up_that_fails_for_now_is_left_to_the_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", _fails(socket.EAI_AGAIN))
    check_hosts(["tcp/no.such.host:17447", "unixsock-stream//tmp/socket"])


def _fails(code: int) -> object:
    def look_up(*args: object, **named: object) -> None:
        raise socket.gaierror(code, "not now")

    return look_up


def test_the_table_of_names_fits_the_flags() -> None:
    """Every parameter that a flag sets is found under the flag."""
    from hapnet.commands.typed import FIELDS

    values = dict.fromkeys(ModelOptions.__dataclass_fields__, 1)
    for parameter in ModelOptions(**values).named("device", "world"):  # type: ignore[arg-type]
        assert parameter in FIELDS or parameter in values
    command = grouped(_all_options)
    assert {field for fields in FIELDS.values() for field in fields} <= set(command.__annotations__)


def _all_options(*, model: ModelOptions, links: LinkOptions, params: ParamsOptions) -> None:
    """Every option of a run."""
