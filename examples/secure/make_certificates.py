"""Certificates for mutual TLS: an authority, a world that listens, devices that dial.

    python examples/secure/make_certificates.py --host 192.168.0.2 --device alice

writes ca.pem, world.pem and alice.pem, each with its key, into certificates/. To add a device of the same authority:

    python examples/secure/make_certificates.py --device bob

Zenoh's access control identifies a device by its common name. Do not copy ca.key to other hosts: anyone who has it can
make further certificates.
"""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

NAME = re.compile(r"[A-Za-z0-9._-]+")
SIGNS_CERTIFICATES = x509.KeyUsage(False, False, False, False, False, True, True, False, False)
Authority = tuple[x509.Certificate, EllipticCurvePrivateKey]


def host_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def issue(name: str, hosts: list[str], days: float, authority: Authority | None = None) -> Authority:
    """A certificate and its key; without `authority` a self-signed certificate of an authority."""
    key = generate_private_key(SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    issuer, signer = (subject, key) if authority is None else (authority[0].subject, authority[1])
    now = datetime.now(UTC)
    begin, end = now - timedelta(minutes=5), now + timedelta(days=days)  # clocks differ
    builder = x509.CertificateBuilder(issuer, subject, key.public_key(), x509.random_serial_number(), begin, end)
    builder = builder.add_extension(x509.BasicConstraints(ca=authority is None, path_length=None), critical=True)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    builder = builder.add_extension(
        x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False
    )
    if authority is None:
        builder = builder.add_extension(SIGNS_CERTIFICATES, critical=True)
    else:
        purposes = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = builder.add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        builder = builder.add_extension(x509.SubjectAlternativeName(map(host_name, hosts)), critical=False)
    return builder.sign(signer, hashes.SHA256()), key


def save(directory: Path, name: str, made: Authority) -> None:
    certificate, key = made
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    for file, data, mode in (
        (f"{name}.key", pem, 0o600),
        (f"{name}.pem", certificate.public_bytes(Encoding.PEM), 0o644),
    ):
        with os.fdopen(os.open(directory / file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as out:
            out.write(data)


def load(directory: Path, name: str) -> Authority | None:
    """The authority in `directory`; None if there is none."""
    certificate, key = directory / f"{name}.pem", directory / f"{name}.key"
    if not certificate.exists() and not key.exists():
        return None
    try:
        made = x509.load_pem_x509_certificate(certificate.read_bytes())
        signer = load_pem_private_key(key.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise typer.BadParameter(f"{directory} has an authority that cannot be used: {error}") from None
    if not isinstance(signer, EllipticCurvePrivateKey) or made.public_key() != signer.public_key():
        raise typer.BadParameter(f"{key} is not the key of {certificate}")
    if made.not_valid_after_utc <= datetime.now(UTC):
        raise typer.BadParameter(f"{certificate} has expired: make a new authority, with another --out")
    return made, signer


def main(
    device: Annotated[list[str], typer.Option(help="Name of a device; repeatable.")],
    host: Annotated[
        list[str] | None,
        typer.Option(help="Address or name that devices dial; repeatable. Needed to make the world's certificate."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Directory for certificates and keys.")] = Path("certificates"),
    days: Annotated[float, typer.Option(help="Validity of the certificates, in days.")] = 365.0,
) -> None:
    """Make an authority, a certificate of the world and one for each device; existing files are not overwritten.

    An existing authority in the directory is used: it signs the new certificates.
    """
    if len({"ca", "world", *device}) < len(device) + 2 or not all(map(NAME.fullmatch, device)):
        raise typer.BadParameter("devices need names of their own (not ca or world) of letters, digits and . _ -")
    authority = load(out, "ca")
    names = {"world": host} if host else {}
    names |= {name: [name] for name in device}
    if authority is None and not host:
        raise typer.BadParameter(f"{out} has no authority yet: give --host, for the world's certificate")
    there = [file for name in names for file in (f"{name}.pem", f"{name}.key") if (out / file).exists()]
    if there:
        raise typer.BadParameter(f"{out} has {', '.join(there)} already; give another --out, or remove them")
    out.mkdir(parents=True, exist_ok=True)
    if authority is None:
        authority = issue("hapnet authority", [], days)
        save(out, "ca", authority)
    most = (authority[0].not_valid_after_utc - datetime.now(UTC)) / timedelta(days=1)
    for name, hosts in names.items():
        save(out, name, issue(name, hosts, min(days, most), authority))


if __name__ == "__main__":
    typer.run(main)
