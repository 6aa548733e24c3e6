"""Every example runs, and says what its docstring promises."""

from __future__ import annotations

import subprocess
import sys
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

ROOT = Path(__file__).resolve().parents[1]


def run(code: str, tmp_path: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, timeout=60
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


def test_modulator(tmp_path: Path) -> None:
    lines = run("from examples.modulator import main; main()", tmp_path).splitlines()
    assert len(lines) == 10
    assert "modulated [ 0.03 -0.02]" in lines[-1]


def test_link_study(tmp_path: Path) -> None:
    lines = run("from examples.link_study import main; main(3.0)", tmp_path).splitlines()
    assert [line.split()[:2] for line in lines[1:3]] == [["ideal", "pspm"], ["ideal", "zoh"]]
    margins = {tuple(line.split()[:2]): float(line.split()[-1]) for line in lines[1:]}
    assert all(margin >= 0.0 for (_, coupling), margin in margins.items() if coupling == "pspm")


def test_own_scene(tmp_path: Path) -> None:
    words = "['simulate','--scene','examples.own_scene:corridor','--duration','2','--no-files']"
    assert "passive" in run(f"from hapnet.cli import main; raise SystemExit(main({words}))", tmp_path)


def test_own_device(tmp_path: Path) -> None:
    words = "['run','--device','examples.own_device:Bench','--duration','1','--out','out']"
    said = run(f"from hapnet.cli import main; raise SystemExit(main({words}))", tmp_path)
    assert "passive" in said
    assert (tmp_path / "out" / "figure.png").exists()


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
    assert "ca.pem" in again.stderr
    assert {name: file.read_bytes() for name, file in made.items()} == before


@pytest.mark.parametrize("device", ["world", "ca", "a/b", "a b", ""])
def test_make_certificates_refuses_names_that_collide(device: str, tmp_path: Path) -> None:
    done = make_certificates(tmp_path, "--host", "127.0.0.1", "--device", device)
    assert done.returncode == 2
    assert "devices need names of their own" in done.stderr
    assert not list(tmp_path.iterdir())


def test_make_certificates_explains_itself(tmp_path: Path) -> None:
    done = make_certificates(tmp_path, "--help")
    assert done.returncode == 0
    assert all(flag in done.stdout for flag in ("--host", "--device", "--out", "--days"))


@pytest.mark.parametrize("file", sorted((ROOT / "examples").glob("*.py")), ids=lambda file: file.stem)
def test_examples_stay_short(file: Path) -> None:
    assert len(file.read_text(encoding="utf-8").splitlines()) < 60
