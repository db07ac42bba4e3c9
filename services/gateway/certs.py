"""`clew certs`: a private certificate authority for the radio, one certificate for each host and console.

A certificate's common name is `role:name`, so what it may do is signed with it: the access rules of both gateways are
by common name (gateway/access.py). Files are in `$CLEW_CERTS_DIR` or ~/.config/clew/certs: `ca.pem`, and `NAME.pem`,
`NAME.key` for each. Only `ca.pem` and a host's own pair belong on that host; `ca.key` stays where certificates are made.
"""

import ipaddress
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from services.gateway.radio import ROLES, common_name

CA_DAYS, CERTIFICATE_DAYS = 3650, 400
_BACKDATED = timedelta(hours=1)  # hosts whose clocks are a little behind must take it at once


class CertsError(Exception):
    """What is wrong with a file, in one line."""


def folder() -> Path:
    """$CLEW_CERTS_DIR, or ~/.config/clew/certs."""
    return Path(os.environ.get("CLEW_CERTS_DIR") or Path.home() / ".config" / "clew" / "certs")


@dataclass(frozen=True)
class Credentials:
    """Paths of what a host needs to speak on the radio."""

    ca: Path
    certificate: Path
    key: Path


def init(into: Path) -> None:
    """Make the authority.

    Raises:
        CertsError: there is one already.
    """
    if (into / "ca.key").exists():
        raise CertsError(f"{into / 'ca.key'}: exists already; whoever trusts it would be shut out by a new one")
    into.mkdir(mode=0o700, parents=True, exist_ok=True)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name("clew authority")
    made = _builder(name, name, key, CA_DAYS).add_extension(x509.BasicConstraints(ca=True, path_length=0), True)
    usage = _key_usage(key_cert_sign=True)
    _write(into / "ca.key", _key_bytes(key), 0o600)
    _write(into / "ca.pem", _pem(made.add_extension(usage, True).sign(key, hashes.SHA256())), 0o644)


def issue(into: Path, name: str, role: str, hosts: Sequence[str] = (), days: float = CERTIFICATE_DAYS) -> None:
    """Make a certificate and its key; `hosts` are the addresses under which it is reached, its name is one of them.

    Raises:
        CertsError: unknown role, a bad or taken name, or no authority here.
    """
    if role not in ROLES:
        raise CertsError(f"role {role!r}: must be one of {', '.join(ROLES)}")
    if not name or name == "ca" or not name.replace("-", "").replace("_", "").isalnum():
        raise CertsError(f"name {name!r}: letters, digits, - and _ only, and not ca")
    if (into / f"{name}.key").exists():
        raise CertsError(f"{into / f'{name}.key'}: exists already; remove it to issue {name} anew")
    authority, authority_key = _authority(into)
    key = ec.generate_private_key(ec.SECP256R1())
    sans = [_san(host) for host in dict.fromkeys((*hosts, name))]
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    made = (
        _builder(_name(common_name(role, name)), authority.subject, key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
        .add_extension(x509.SubjectAlternativeName(sans), False)
        .add_extension(x509.ExtendedKeyUsage(uses), False)
        .sign(authority_key, hashes.SHA256())
    )
    _write(into / f"{name}.key", _key_bytes(key), 0o600)
    _write(into / f"{name}.pem", _pem(made), 0o644)


def credentials(of: Path, name: str, role: str, address: str = "") -> Credentials:
    """The files of `name`, after a look at each; `address` is where it will be reached, if it listens.

    Raises:
        CertsError: naming the file and what is wrong with it.
    """
    found = Credentials(of / "ca.pem", of / f"{name}.pem", of / f"{name}.key")
    if not found.ca.is_file():
        raise CertsError(f"{found.ca}: is missing: copy it from the one machine where clew certs init made it")
    for file in (found.certificate, found.key):
        if not file.is_file():
            raise CertsError(f"{file}: is missing: clew certs issue {name} --role {role} makes it, where ca.key is")
    mode = found.key.stat().st_mode & 0o777
    if mode & 0o077:
        raise CertsError(f"{found.key}: mode {mode:o}: must be 600, others can read it")
    for fault in _faults(found, common_name(role, name), address):
        raise CertsError(f"{found.certificate}: {fault}")
    return found


def show(of: Path) -> list[tuple[str, ...]]:
    """Name, role, addresses, end and state of each certificate in a folder; the authority first."""
    files = sorted(of.glob("*.pem"), key=lambda file: (file.stem != "ca", file.stem))
    return [_row(_load(file), file, of) for file in files]


def _row(found: x509.Certificate, file: Path, of: Path) -> tuple[str, ...]:
    role, _, name = _common_name(found).rpartition(":")
    if file.stem == "ca":
        state = _time_fault(found) or "good"
        return ("ca", "authority", "", f"{found.not_valid_after_utc:%Y-%m-%d}", state)
    try:
        credentials(of, name, role)
        state = "good"
    except CertsError as error:
        state = str(error).partition(": ")[2]
    return (name, role, ", ".join(_addresses(found)), f"{found.not_valid_after_utc:%Y-%m-%d}", state)


def _faults(found: Credentials, expected: str, address: str) -> Iterator[str]:
    certificate, authority = _load(found.certificate), _load(found.ca)
    if (name := _common_name(certificate)) != expected:
        yield f"is made out to {name}, this profile needs {expected}"
    if fault := _time_fault(certificate):
        yield fault
    try:
        certificate.verify_directly_issued_by(authority)
    except Exception:
        yield f"was not issued by the authority of {found.ca}"
    try:
        key = serialization.load_pem_private_key(_bytes(found.key), None)
    except (TypeError, ValueError):
        raise CertsError(f"{found.key}: is no key, or one with a password") from None
    if key.public_key() != certificate.public_key():
        yield f"does not belong to {found.key}"
    if address and address not in _addresses(certificate):
        yield f"is for {', '.join(_addresses(certificate))}, but radio.address = {address}"


def _time_fault(found: x509.Certificate) -> str:
    now = datetime.now(UTC)
    if now > found.not_valid_after_utc:
        return f"expired on {found.not_valid_after_utc:%Y-%m-%d %H:%M} UTC"
    if now < found.not_valid_before_utc:
        return f"is not valid before {found.not_valid_before_utc:%Y-%m-%d %H:%M} UTC: is this host's clock right?"
    return ""


def _common_name(found: x509.Certificate) -> str:
    return str(found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def _addresses(found: x509.Certificate) -> list[str]:
    try:
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names]


def _load(file: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(_bytes(file))
    except ValueError:
        raise CertsError(f"{file}: is no certificate") from None


def _bytes(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except PermissionError:
        raise CertsError(f"{file}: belongs to {file.owner()}: this user cannot read it") from None


def _authority(of: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    if not (of / "ca.key").is_file():
        raise CertsError(f"{of / 'ca.key'}: is missing; clew certs init makes it")
    key = serialization.load_pem_private_key((of / "ca.key").read_bytes(), None)
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise CertsError(f"{of / 'ca.key'}: is not a key of clew certs")
    return _load(of / "ca.pem"), key


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: float
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - max(_BACKDATED, timedelta(days=-2 * days)))
        .not_valid_after(now + timedelta(days=days))
    )


def _key_usage(*, key_cert_sign: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=key_cert_sign,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _san(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(file: Path, data: bytes, mode: int) -> None:
    """Created with its mode, so that a key is never readable for a moment."""
    with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as opened:
        opened.write(data)
