"""Keystores as written by ``ros2 security`` (sros2, ``keystore/_keystore.py`` and ``_enclave.py``), for tests.

Each part can be replaced by an invalid one.
"""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, pkcs7

from ship_bringup.security.policy_xml import governance_text, permissions_text
from ship_bringup.security.rights import Rights

UTC = datetime.timezone.utc
NOW = datetime.datetime(2026, 6, 1, 12, 0, tzinfo=UTC)
YEAR = datetime.timedelta(days=365)
DAY = datetime.timedelta(days=1)


@dataclass(frozen=True)
class Authority:
    """A certificate authority."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate


def new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def certificate_of(
    subject: str,
    key: ec.EllipticCurvePrivateKey,
    authority: Authority | None = None,
    now: datetime.datetime = NOW,
) -> x509.Certificate:
    """Return a certificate of ``authority``, or a self-signed one if ``authority`` is None."""
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, subject)])
    issuer = name if authority is None else authority.certificate.subject
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(issuer).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - DAY).not_valid_after(now + YEAR)
    constraints = x509.BasicConstraints(ca=authority is None, path_length=1 if authority is None else None)
    builder = builder.add_extension(constraints, critical=authority is None)
    return builder.sign(key if authority is None else authority.key, hashes.SHA256())


def new_authority(name: str = "sros2CA", now: datetime.datetime = NOW) -> Authority:
    key = new_key()
    return Authority(key, certificate_of(name, key, now=now))


def sign_text(text: str, authority: Authority) -> bytes:
    """Return S/MIME as signed by sros2 (``_utilities.py``, ``_sign_bytes_pkcs7``)."""
    builder = pkcs7.PKCS7SignatureBuilder().set_data(text.encode("utf-8"))
    builder = builder.add_signer(authority.certificate, authority.key, hashes.SHA256())
    return builder.sign(Encoding.SMIME, [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature])


class Keystore:
    """Keystore created at the time ``now``; a file written later replaces the earlier file of the same path."""

    def __init__(self, path: Path, authority: Authority, domain_id: int = 7, now: datetime.datetime = NOW) -> None:
        self.path, self.authority, self.domain_id, self.now = path, authority, domain_id, now

    def folder(self, enclave: str) -> Path:
        return self.path / "enclaves" / enclave.lstrip("/")

    def add(self, all_rights: Sequence[Rights]) -> "Keystore":
        """Add valid enclaves."""
        for rights in all_rights:
            folder = self.folder(rights.enclave)
            folder.mkdir(parents=True, exist_ok=True)
            for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
                self.write_certificate(folder / name, self.authority.certificate)
            key = new_key()
            self.write_certificate(folder / "cert.pem", certificate_of(rights.enclave, key, self.authority, self.now))
            self.write_key(rights.enclave, key)
            self.sign(folder / "governance.p7s", governance_text(self.domain_id))
            self.permit(rights.enclave, rights)
        return self

    def permit(self, enclave: str, rights: Rights, valid: datetime.timedelta = YEAR) -> None:
        text = permissions_text(rights, self.domain_id, self.now - DAY, self.now + valid)
        self.sign(self.folder(enclave) / "permissions.p7s", text)

    def sign(self, path: Path, text: str, authority: Authority | None = None) -> None:
        path.write_bytes(sign_text(text, authority or self.authority))

    def write_key(self, enclave: str, key: ec.EllipticCurvePrivateKey, mode: int = 0o600) -> None:
        path = self.folder(enclave) / "key.pem"
        path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        path.chmod(mode)

    @staticmethod
    def write_certificate(path: Path, certificate: x509.Certificate) -> None:
        path.write_bytes(certificate.public_bytes(Encoding.PEM))
