"""Certificates and users, for tests of who may do what."""

from dataclasses import replace
from pathlib import Path

import pytest

from hapnet.transport.security import Security
from tests.support.transports import own

ACCESS = str(Path(__file__).resolve().parents[2] / "examples" / "secure" / "access.json5")

TLS = "transport/link/tls"
USRPWD = "transport/auth/usrpwd"


def shows(certificates: Path, name: str) -> Security:
    """A certificate, and no look at the other's."""
    return replace(own(certificates, name), tls_ca=None)


@pytest.fixture
def users(tmp_path: Path) -> Path:
    file = tmp_path / "users"
    file.write_text("alice:secret\nbob:b:o b", "utf-8")
    file.chmod(0o600)
    return file
