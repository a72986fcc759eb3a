"""Files of a keystore and their faults: X.509 certificates, permissions, private keys that must not be aboard.

A certificate is read, and weaknesses of its key and signature are found.
"""

import datetime
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import dsa, ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from ship_bags.errors import BadInput

LEAST_RSA_BITS = 2048
LEAST_CURVE_BITS = 256
LEAST_DIGEST_BITS = 256
"""Minimum length of a digest, bits; excludes MD5, SHA-1 and all forms of SHA-224."""

_KEY = "key.pem"
_OTHERS_READ = 0o004
_GROUP_WRITE, _OTHERS_WRITE = 0o020, 0o002
_LARGEST_KEY_BYTES = 100_000
_KEY_MARK = b"PRIVATE KEY-----"


@dataclass(frozen=True)
class KeystoreFault:
    """One fault of a keystore.

    Attributes:
        text: one line with file, line, fault and what was expected.
        advice: what to do.
        is_error: True for a FAIL of ``preflight``, False for a WARN. An error prevents the start of the suite, unless
            `is_weakness` or `of_policy` is true.
        is_weakness: True if the suite can run with the fault, but is less protected; the fault is corrected ashore.
        of_policy: True if the fault concerns rules of governance or permissions, not identities, dates or signatures.
    """

    text: str
    advice: str
    is_error: bool = True
    of_policy: bool = False
    is_weakness: bool = False


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


def mode_faults(keystore: Path, folders: Sequence[Path], names: Sequence[str]) -> Iterator[KeystoreFault]:
    """Yield faults about folders and files that other users may change, and keys that other users may read.

    Args:
        keystore: folder of the keystore.
        folders: folders with used files.
        names: names of the files that are used.
    """
    holders = {keystore, *folders}
    for folder in folders:
        holders.update(parent for parent in folder.parents if parent.is_relative_to(keystore))
    for holder in sorted(filter(Path.is_dir, holders)):
        yield from _write_faults(holder, "replace the files in it")
    # A link has the mode of its target, so links are resolved and each file is checked once.
    files = {path.resolve(): path for folder in folders for name in names if (path := folder / name).is_file()}
    for path in sorted(files.values()):
        if path.name != _KEY:
            yield from _write_faults(path, "change it")
        elif (mode := path.stat().st_mode) & (_OTHERS_READ | _GROUP_WRITE | _OTHERS_WRITE):
            text = f"{path}: mode {mode & 0o777:o}: others may read or change the private key"
            yield KeystoreFault(text, f"chmod 600 {path}")


def authority_key_faults(keystore: Path, authorities: Sequence[x509.Certificate]) -> Iterator[KeystoreFault]:
    """Yield faults about private keys that belong to an authority, or are in a file not named ``key.pem``."""
    names = {certificate_key(each): common_name(each.subject) for each in authorities}
    for path in _private_keys(keystore):
        name = names.get(_public_key(path))
        if name is None and path.name == _KEY:
            continue
        of = "a certificate authority, by its place" if name is None else f"the authority 'CN={name}'"
        text = f"{path}: the private key of {of}: whoever reads it can make certificates of this ship"
        yield KeystoreFault(text, "keep it ashore, and remove it from this computer", is_weakness=True)


def _write_faults(path: Path, harm: str) -> Iterator[KeystoreFault]:
    """Yield a fault about write access: an error for all users, a warning for a group, whose access may be intended."""
    mode = path.stat().st_mode
    if mode & (_GROUP_WRITE | _OTHERS_WRITE):
        is_open = bool(mode & _OTHERS_WRITE)
        users = "all users" if is_open else "its group"
        text = f"{path}: mode {mode & 0o777:o}: {users} may {harm}"
        yield KeystoreFault(text, f"chmod go-w {path}", is_error=is_open, is_weakness=True)


def _private_keys(keystore: Path) -> list[Path]:
    """Return the files of a keystore that contain a private key (PEM), each once; links are resolved."""
    paths = (Path(folder) / name for folder, _, names in os.walk(keystore) for name in names)
    return sorted({path.resolve() for path in paths if _has_private_key(path)})


def _has_private_key(path: Path) -> bool:
    """True if a file contains a private key (PEM) that this user can read."""
    try:
        return path.is_file() and path.stat().st_size <= _LARGEST_KEY_BYTES and _KEY_MARK in path.read_bytes()
    except OSError:
        return False


def _public_key(path: Path) -> bytes | None:
    """Return the public key of a private key (PEM); None for a key with a password or of an unsupported kind."""
    try:
        return public_bytes(load_pem_private_key(path.read_bytes(), password=None).public_key())
    except (ValueError, TypeError, UnsupportedAlgorithm):
        return None
