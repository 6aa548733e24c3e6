"""Every example runs, and says what theory says."""

import ast
import json
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from ipaddress import ip_address
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import typer
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

import hapnet
from examples.pictures import ring
from examples.secure import make_certificates as certificates
from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.conftest import ENVIRONMENT, ROOT, mostly_slow
from tests.support.processes import started

EXAMPLES = {file.stem: file for file in sorted((ROOT / "examples").glob("*.py"))}
LONG = {"pantograph": 110, "bullet_world": 138, "position_arm": 81}
"""A linkage, its driver, and what moves it; a whole physics engine; an arm, its model and its kinematics."""

NUMBER = r"(-?\d+(?:\.\d+)?)"


def run(name: str, *argv: object, cwd: Path) -> str:
    """What an example prints, started as a user starts it."""
    return printed([sys.executable, str(EXAMPLES[name]), *map(str, argv)], cwd)


def printed(command: Sequence[str], cwd: Path) -> str:
    """What a program prints that ends well."""
    done = subprocess.run(command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def numbers(pattern: str, text: str) -> list[tuple[float, ...]]:
    """The numbers in every place that fits, where the pattern has a #."""
    found = re.finditer(re.escape(pattern).replace(r"\#", NUMBER).replace(r"\ ", r"\s+"), text)
    return [tuple(map(float, match.groups())) for match in found]


def test_the_page_lists_every_example() -> None:
    page = (ROOT / "examples" / "README.md").read_text("utf-8")
    assert {name for name in EXAMPLES if f"{name}.py" not in page} == set()


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_short_and_needs_public_names_only(name: str) -> None:
    text = EXAMPLES[name].read_text(encoding="utf-8")
    assert len(text.splitlines()) <= LONG.get(name, 70)
    imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    used = {(node.module, alias.name) for node in imports for alias in node.names}
    ours = {(module, name) for module, name in used if (module or "").partition(".")[0] == "hapnet"}
    assert ours
    assert ours <= {("hapnet", name) for name in hapnet.__all__} | {("hapnet.cli", "main")}


def test_public_names_are_loaded_on_first_use() -> None:
    assert all(getattr(hapnet, name).__name__ == name for name in hapnet.__all__)
    assert all(f"`{name}`" in (hapnet.__doc__ or "") for name in hapnet.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Simulate'"):
        _ = hapnet.Simulate
    code = "import sys, hapnet; print({'numpy', 'zenoh'} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], env=ENVIRONMENT, text=True) == "set()\n"


@pytest.mark.slow
def test_fields() -> None:
    said = run("fields", cwd=ROOT)
    assert said.count(": gave out at most ") == 2  # passive
    assert [float(slack) >= -1e-15 for slack in re.findall(r"never below (\S+) J", said)] == [True, True]


@pytest.mark.slow
@pytest.mark.realtime
def test_own_device(tmp_path: Path) -> None:
    """The carriage rests where K (x - p) = W and K'/K W = K_w (p - wall); W is its weight along the rail."""
    busy = ("--set", "device.watchdog_s=0")  # a machine that tests may be late
    said = run("own_device", "--out", tmp_path, "--duration", 2, *busy, cwd=ROOT)
    assert "PASSIVE: gave out at most" in said
    device = read_recording(tmp_path / "device.mcap").device
    at_rest = device["time_s"] > 1.5
    weight, K, K_v, wall, K_w = 1.0, 100.0, 500.0, 0.02, 3000.0
    p = wall + K_v / K * weight / K_w
    assert np.median(device["position_m"][at_rest]) == pytest.approx(p + weight / K, abs=5e-4)
    assert np.median(device["force_N"][at_rest]) == pytest.approx(-weight, rel=0.05)
    assert (tmp_path / "figure.png").exists()


@pytest.mark.slow
@pytest.mark.realtime
def test_pantograph(tmp_path: Path) -> None:
    """The hand of 40 N/m wants 30 mm: K_h (30 mm - x) = K (x - p) and K'/K W = K_w (p - wall), W the force felt."""
    busy = ("--set", "device.watchdog_s=0")
    said = run("pantograph", "--out", tmp_path, "--duration", 4, *busy, cwd=ROOT)
    assert "PASSIVE: gave out at most" in said
    device = read_recording(tmp_path / "device.mcap").device
    at_rest = device["time_s"] > 3.0
    hand, K, K_v, wall, K_w = 40.0, 100.0, 500.0, 0.02, 3000.0
    felt = (0.03 - wall) / (1.0 / hand + 1.0 / K + K_v / K / K_w)
    x, y = np.median(device["position_m"][at_rest], axis=0)
    assert x == pytest.approx(0.03 - felt / hand, abs=5e-4)
    assert y == pytest.approx(0.0, abs=5e-4)
    assert np.median(device["force_N"][at_rest], axis=0) == pytest.approx([-felt, 0.0], abs=0.02)


@pytest.mark.slow
def test_own_world(tmp_path: Path) -> None:
    """A slow hand: K_h (A - x) = K (x - p) and K' (x - p) = K_w (p - wall) at the sine's crest, at either wall."""
    said = run("own_world", cwd=tmp_path)
    walls = numbers("wall, # N/m: # mm deep, # N felt", said)
    assert [wall[0] for wall in walls] == [100.0, 1000.0]
    hand, K, K_v, amplitude = 135.0, 600.0, 500.0, 0.03
    for K_w, depth_mm, felt_N in walls:
        x, p = np.linalg.solve([[hand + K, -K], [K_v, -K_v - K_w]], [hand * amplitude, -K_w * 0.02])
        assert depth_mm == pytest.approx(1e3 * (p - 0.02), rel=0.1)
        assert felt_N == pytest.approx(K * (x - p), abs=0.05)
    ((out, bound),) = numbers("passive: True; gave out at most # mJ of the # mJ allowed", said)
    assert 0.0 <= out < bound == 150.0


@pytest.mark.slow
def test_own_moving_world(tmp_path: Path) -> None:
    """A hand at rest, K_h = 135 N/m, in series with both couplings and the piston's face, which comes to x = -5 mm."""
    said = run("own_moving_world", cwd=tmp_path)
    ((push,),) = numbers("the piston pushed with # N at most", said)
    series = 1.0 / (1.0 / 135.0 + 1.0 / 200.0 + 1.0 / 500.0 + 1.0 / 2000.0)
    assert 0.005 * series < push < 2.5  # pushed at least as far as it comes: the magnet's pull and dampers come on top
    ((supplied, slack),) = numbers("its motor put in # mJ, the world's slack is # mJ", said)
    assert supplied > 1.0
    assert slack == 0.0
    assert f"energy came from the motors of the world ({supplied:.4g} mJ)" in said


@pytest.mark.slow
@pytest.mark.realtime
def test_planet(tmp_path: Path) -> None:
    """A ball of 1000 N/m with a radius of 12 mm pushes with 12 N at most; its motor's work is not nothing."""
    said = run("planet", cwd=tmp_path)
    ((push, given),) = numbers("the ball pushed with # N at most; its drive gave # mJ", said)
    assert 0.1 < push < 12.0
    assert given != 0.0
    assert "gave out at most" in said


@pytest.mark.slow
@pytest.mark.realtime
def test_bullet_world(tmp_path: Path) -> None:
    """Nothing is undone, and the world keeps what it was given."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install pybullet")
    ((slack, undone),) = numbers("slack # mJ, # substeps undone", said := run("bullet_world", cwd=tmp_path))
    assert slack >= 0.0
    assert undone == 0.0
    assert "gave out at most" in said


@pytest.mark.slow
@pytest.mark.realtime
def test_position_arm(tmp_path: Path) -> None:
    """200 and 500 N/m in series press with 1.4 N over 10 mm; a late arm swings, to three times that at most."""
    pytest.importorskip("mink", reason="mink is not installed: pip install mink daqp")
    ((push,),) = numbers("the foam pushed with # N at most", said := run("position_arm", cwd=tmp_path))
    ((paid, slack),) = numbers("damping took # mJ; slack # mJ", said)
    assert 0.5 < push < 4.3
    assert paid > 0.1
    assert slack > -1e-9
    assert "gave out at most" in said


@pytest.mark.slow
@pytest.mark.realtime
def test_own_moving_world_over_zenoh(tmp_path: Path) -> None:
    """Two processes: the motor's work crosses from one to the other's summary, and the world's account holds."""
    argv = ["run", "--scene", "examples.own_moving_world:workshop", "--operator", "rest", "--duration", "4"]
    stdout = printed([sys.executable, "-m", "hapnet", *argv, "--json", "-", "--out", str(tmp_path / "run")], tmp_path)
    summary = json.loads(stdout)
    own = summary["environment"]
    assert own["env_supplied_J"] > 1e-3
    assert own["env_slack_J"] >= -1e-14
    assert summary["verdict"]["passive"] is not False
    assert "energy came from the motors of the world" in summary["verdict"]["reason"]


@pytest.mark.slow
@pytest.mark.realtime
def test_own_law_over_zenoh(tmp_path: Path) -> None:
    """Two processes. 100 N/m, softened by 40 + 10 ms in each direction: 100/(1 + 0.1/0.1); a law of one's own claims
    nothing."""
    link = ("--delay", "40ms", "--jitter", "10ms", "--duration", "3", "--seed", "1")
    argv = ["run", "--coupling", "examples.own_law:Mine", *link, "--json", "-", "--out", str(tmp_path / "run")]
    stdout = printed([sys.executable, "-m", "hapnet", *argv], tmp_path)
    summary = json.loads(stdout)
    assert summary["coupling"] == "examples.own_law:Mine"
    assert summary["tuning"] == pytest.approx({"stiffness_N_m": 50.0, "damping_Ns_m": 1.5}, rel=0.05)
    assert summary["motion"]["peak_force_N"] > 0.2
    for way in ("up", "down"):
        assert summary["links"][way]["delivered"] >= 50


def test_own_law() -> None:
    assert "gave out at most" in run("own_law", cwd=ROOT)


@pytest.mark.parametrize(
    ("name", "says"), [("examples.own_law:Tuning", "this is a type"), ("nowhere:X", "cannot import module 'nowhere'")]
)
def test_a_law_that_is_none_is_refused_with_its_name(name: str, says: str) -> None:
    with pytest.raises(hapnet.InvalidParameter, match=rf"coupling (is )?'?{name}.*{says}"):
        hapnet.simulate(hapnet.Params(coupling=name), seed=1)


def test_own_world_on_the_command_line(tmp_path: Path) -> None:
    argv = ["simulate", "--scene", "examples.own_world:corridor", "--dof", "2", "--duration", "1", "--no-files"]
    stdout = printed([sys.executable, "-m", "hapnet", *argv], tmp_path)
    assert "PASSIVE: gave out at most" in stdout


@pytest.mark.slow
@pytest.mark.realtime
def test_two_hosts(tmp_path: Path) -> None:
    """Both sides end, and what one sent is what the other was credited, to the nanojoule."""
    said = run("two_hosts", "--port", free_address().rpartition(":")[2], cwd=tmp_path)
    words = ": # s, emulated delay # ms, gave out at most # of # mJ, energy sent # nJ, credited # nJ"
    ((device,), (world,)) = (numbers(role + words, said) for role in ("device", "world"))
    for (seconds, delay_ms, out_mJ, bound_mJ, sent_nJ, _), ceiling_mJ in ((device, 100.0), (world, 50.0)):
        assert 3.0 <= seconds < 4.0
        assert delay_ms == pytest.approx(20.0, abs=2.5)
        assert 0.0 <= out_mJ < bound_mJ == ceiling_mJ
        assert sent_nJ > 0.0
    assert (device[4], device[5]) == (world[5], world[4])


@pytest.mark.realtime
def test_a_host_on_its_own_is_told_to_stop() -> None:
    port = free_address().rpartition(":")[2]
    command = (sys.executable, str(EXAMPLES["two_hosts"]))
    with started("world", "127.0.0.1", "--port", port, command=command) as world:
        world.until_line(f"tcp/127.0.0.1:{port}")
        world.process.send_signal(signal.SIGINT)
        assert world.end() == (1, f"world: tcp/127.0.0.1:{port}\n", "world: no peer came\n")


@pytest.mark.slow
def test_link_study(tmp_path: Path) -> None:
    """Theorem 1 with PSPM at every delay; the plain coupling breaks it, and shakes the hand."""
    said = run("link_study", cwd=tmp_path)
    pspm, zoh = (
        {delay: (out, error) for delay, out, error in numbers(f"# {words} # #", said)}
        for words in ("PSPM", "plain virtual coupling")
    )
    assert pspm.keys() == zoh.keys() >= {0.0, 60.0}
    assert all(out <= 100.0 for out, _ in pspm.values())
    assert zoh[0.0][0] < 100.0
    assert zoh[60.0][0] > 600.0
    assert zoh[60.0][1] > 3.0 * pspm[60.0][1]
    assert (tmp_path / "runs" / "link_study.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.realtime
@pytest.mark.slow
def test_asyncio_program(tmp_path: Path) -> None:
    said = run("asyncio_program", cwd=tmp_path)
    rows = numbers("# s: delay up to # ms (p99), # of # messages lost, passivity margin now # mJ", said)
    assert [row[1] for row in rows] == pytest.approx(3 * [10.0] + 3 * [50.0], rel=0.012)  # a bin is 1.1 % wide
    assert all(before[0] < after[0] and before[3] < after[3] for before, after in pairwise(rows))
    assert all(margin > 0.0 for *_, margin in rows)
    assert "world: paired with the device" in said
    assert "world: emulated link, delay 50ms loss 5%" in said
    ((sent, credited),) = numbers("world: energy sent # nJ, credited # nJ", said)
    assert numbers("device: energy sent # nJ, credited # nJ", said) == [(credited, sent)]
    assert credited > 0.0  # the hand worked


def make_certificates(tmp_path: Path, *argv: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "examples" / "secure" / "make_certificates.py"), *argv]
    return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)


def test_make_certificates(tmp_path: Path) -> None:
    """Each is signed by the authority; keys are the owner's; nothing is overwritten."""
    argv = ("--host", "192.168.0.2", "--host", "world.example", "--device", "alice", "--device", "bob")
    done = make_certificates(tmp_path, *argv)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    made = {file.name: file for file in (tmp_path / "certificates").iterdir()}
    assert set(made) == {f"{name}{end}" for name in ("ca", "world", "alice", "bob") for end in (".pem", ".key")}
    for name in ("ca", "world", "alice", "bob"):
        assert made[f"{name}.key"].stat().st_mode & 0o777 == 0o600
    ca, world, alice = (
        x509.load_pem_x509_certificate(made[f"{name}.pem"].read_bytes()) for name in ("ca", "world", "alice")
    )
    for certificate in (world, alice):
        certificate.verify_directly_issued_by(ca)
        purposes = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert set(purposes) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    names = world.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["world.example"]
    assert names.get_values_for_type(x509.IPAddress) == [ip_address("192.168.0.2")]
    assert [name.value for name in alice.subject] == ["alice"]

    before = {name: file.read_bytes() for name, file in made.items()}
    again = make_certificates(tmp_path, *argv)
    assert again.returncode == 2
    assert "world.pem" in again.stderr
    assert {name: file.read_bytes() for name, file in made.items()} == before


def test_make_certificates_adds_a_device_to_an_authority_that_is_there(tmp_path: Path) -> None:
    directory = tmp_path / "certificates"
    certificates.main(["alice"], ["127.0.0.1"], directory, days=2.0)
    before = {file.name: file.read_bytes() for file in directory.iterdir()}
    certificates.main(["bob"], None, directory)
    assert {file.name for file in directory.iterdir()} - set(before) == {"bob.pem", "bob.key"}
    assert {name: (directory / name).read_bytes() for name in before} == before
    ca, bob = (x509.load_pem_x509_certificate((directory / f"{name}.pem").read_bytes()) for name in ("ca", "bob"))
    bob.verify_directly_issued_by(ca)
    assert bob.not_valid_after_utc <= ca.not_valid_after_utc

    with pytest.raises(typer.BadParameter, match="has no authority yet: give --host"):
        certificates.main(["bob"], None, tmp_path / "elsewhere")
    assert not (tmp_path / "elsewhere").exists()
    (directory / "ca.key").write_bytes(before["alice.key"])
    with pytest.raises(typer.BadParameter, match="is not the key of"):
        certificates.main(["carol"], None, directory)


@pytest.mark.parametrize("device", mostly_slow(["world", "ca", "a/b", "a b", ""], 1))
def test_make_certificates_refuses_names_that_collide(device: str, tmp_path: Path) -> None:
    done = make_certificates(tmp_path, "--host", "127.0.0.1", "--device", device)
    assert done.returncode == 2
    assert "devices need names of their own" in done.stderr
    assert not list(tmp_path.iterdir())


def test_make_certificates_explains_itself(tmp_path: Path) -> None:
    done = make_certificates(tmp_path, "--help")
    assert done.returncode == 0
    assert all(flag in done.stdout for flag in ("--host", "--device", "--out", "--days"))


def test_the_ring_is_what_its_script_makes_a_closed_torus() -> None:
    """Its volume is that of Pappus' theorem, less what 32 corners cut off a circle and 64 off its way."""
    pytest.importorskip("igl", reason="libigl is not installed")
    from hapnet.ext.solids.mesh_file import read_mesh
    from hapnet.ext.solids.mesh_surface import require_closed, volume

    assert ring.FILE.read_text("utf-8") == ring.ring()
    corners, triangles = read_mesh(str(ring.FILE), 1e-3)
    assert len(triangles) == 4096
    require_closed(triangles)
    circle = 0.5 * 32 * np.sin(2.0 * np.pi / 32) * 0.012**2
    assert volume(corners, triangles) == pytest.approx(2.0 * np.pi * 0.030 * circle, rel=5e-3)
