"""Certificates for mutual TLS: an authority, a world that listens, devices that dial.

    python examples/secure/make_certificates.py --host 192.168.0.2 --device alice

writes ca.pem, world.pem and alice.pem, each with its key, into certificates/. A device's common name is what Zenoh's
access control knows it by. Keep ca.key where it was made: whoever has it can make further certificates.
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
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
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
    """A certificate and its key; without an authority it is one, and signs itself."""
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


def main(
    host: Annotated[list[str], typer.Option(help="Address or name that devices dial; repeatable.")],
    device: Annotated[list[str], typer.Option(help="Name of a device; repeatable.")],
    out: Annotated[Path, typer.Option(help="Directory for what is made.")] = Path("certificates"),
    days: Annotated[float, typer.Option(help="How long they are valid.")] = 365.0,
) -> None:
    """Make an authority, a certificate of the world and one for each device; what is there is not overwritten."""
    names = ["ca", "world", *device]
    if len(set(names)) < len(names) or not all(map(NAME.fullmatch, device)):
        raise typer.BadParameter("devices need names of their own (not ca or world) of letters, digits and . _ -")
    out.mkdir(parents=True, exist_ok=True)
    there = [file for name in names for file in (f"{name}.pem", f"{name}.key") if (out / file).exists()]
    if there:
        raise typer.BadParameter(f"{out} has {', '.join(there)} already; give another --out, or remove them")
    authority = issue("hapnet authority", [], days)
    save(out, "ca", authority)
    save(out, "world", issue("world", host, days, authority))
    for name in device:
        save(out, name, issue(name, [name], days, authority))


if __name__ == "__main__":
    typer.run(main)
