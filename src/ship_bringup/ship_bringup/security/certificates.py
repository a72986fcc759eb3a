"""X.509 certificates of a keystore: reading a certificate, and weaknesses of its key and signature."""

import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import dsa, ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ship_bags.errors import BadInput

LEAST_RSA_BITS = 2048
LEAST_CURVE_BITS = 256
LEAST_DIGEST_BITS = 256
"""Minimum length of a digest, bits; excludes MD5, SHA-1 and all forms of SHA-224."""


def read_certificate(path: Path) -> x509.Certificate:
    """Read a certificate.

    Raises:
        BadInput: the file cannot be read, or is not a certificate.
    """
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as problem:
        raise BadInput(f"cannot be read: {problem.strerror}", file=path) from problem
    except ValueError as problem:
        raise BadInput("is not a certificate (PEM, X.509)", file=path) from problem


def weaknesses(certificate: x509.Certificate) -> Iterator[str]:
    """Yield each weakness of the key or the signature of a certificate, with the required minimum."""
    try:
        key = certificate.public_key()
    except (ValueError, UnsupportedAlgorithm) as problem:
        yield f"its key cannot be used ({problem}): expected a curve of {LEAST_CURVE_BITS} bits, as prime256v1"
    else:
        yield from _key_weaknesses(key)
    try:
        digest = certificate.signature_hash_algorithm
    except UnsupportedAlgorithm as problem:
        yield f"its signature cannot be checked ({problem}): expected SHA-256"
    else:
        if digest is not None and 8 * digest.digest_size < LEAST_DIGEST_BITS:
            yield f"it is signed with {digest.name.upper()}: expected SHA-256 or longer"


def is_authority(certificate: x509.Certificate) -> bool:
    """True if a certificate may issue other certificates (CA:TRUE)."""
    try:
        return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except (x509.ExtensionNotFound, ValueError):
        return False


def is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """True if the authority has signed the certificate."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        return False
    return True


def common_name(name: x509.Name) -> str:
    """Return the common name (CN) in a name; empty if the name contains no CN."""
    found = name.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def validity(certificate: x509.Certificate) -> tuple[datetime.datetime, datetime.datetime]:
    """Return begin and end of the validity, UTC; cryptography below version 42 (Ubuntu 24.04) omits the time zone."""
    if hasattr(certificate, "not_valid_after_utc"):
        return certificate.not_valid_before_utc, certificate.not_valid_after_utc
    utc = datetime.timezone.utc
    return certificate.not_valid_before.replace(tzinfo=utc), certificate.not_valid_after.replace(tzinfo=utc)


def certificate_key(certificate: x509.Certificate) -> bytes | None:
    """Return the public key of a certificate (PEM); None if its kind is not supported."""
    try:
        return public_bytes(certificate.public_key())
    except (ValueError, UnsupportedAlgorithm):
        return None


def public_bytes(key: Any) -> bytes:
    """Return a public key as PEM."""
    return bytes(key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))


def _key_weaknesses(key: Any) -> Iterator[str]:
    if isinstance(key, rsa.RSAPublicKey) and key.key_size < LEAST_RSA_BITS:
        yield f"its RSA key has {key.key_size} bits: expected at least {LEAST_RSA_BITS}"
    elif isinstance(key, ec.EllipticCurvePublicKey) and key.curve.key_size < LEAST_CURVE_BITS:
        expected = f"expected at least {LEAST_CURVE_BITS}, as prime256v1"
        yield f"its curve {key.curve.name} has {key.curve.key_size} bits: {expected}"
    elif isinstance(key, dsa.DSAPublicKey):
        yield f"its key is DSA: expected a curve of {LEAST_CURVE_BITS} bits, as prime256v1"
