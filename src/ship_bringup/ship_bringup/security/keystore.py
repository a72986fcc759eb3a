"""The keystore of a ship, as ``ros2 security`` lays it out, against the suite that is to run with it.

Whatever is wrong is told as one line with file, line and what was expected; nothing is changed. A keystore of another
ship has other enclaves, or another authority, or other subjects: each is told as such.
"""

import datetime
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from ship_bags.errors import BadInput
from ship_bringup.security.policy_xml import FINGERPRINT, published, subscribed
from ship_bringup.security.rights import Rights
from ship_bringup.security.signed_xml import (
    Permissions,
    governance_faults,
    read_permissions,
    read_signed,
    signature_fault,
)

ENCLAVES = "enclaves"
_PUBLIC = "public"
_IDENTITY_CA, _PERMISSIONS_CA = "identity_ca.cert.pem", "permissions_ca.cert.pem"
_CERTIFICATE, _KEY, _GOVERNANCE, _PERMISSIONS = "cert.pem", "key.pem", "governance.p7s", "permissions.p7s"
_FILES = _IDENTITY_CA, _PERMISSIONS_CA, _CERTIFICATE, _KEY, _GOVERNANCE, _PERMISSIONS
_MOST_NAMED = 3
_OTHERS_READ = 0o004
_OTHERS_WRITE = 0o022


@dataclass(frozen=True)
class KeystoreFault:
    """One thing that is wrong.

    Attributes:
        text: one line: file, line, what it is and what was expected.
        advice: what to do.
        is_error: whether the suite is not to start with it; otherwise people should know.
        of_policy: whether it is about what an enclave may do, and not about who it is.
    """

    text: str
    advice: str
    is_error: bool = True
    of_policy: bool = False


@dataclass(frozen=True)
class KeystoreUse:
    """What a keystore is to be good for.

    Attributes:
        rights: of all programs of the suite; enclaves that are not needed here may be on other computers.
        domain_id: ROS_DOMAIN_ID.
        now: UTC.
        voyage: until so long after `now` everything must be valid.
        authority_sha256: of the ship's identity authority, in hexadecimal; empty where the ship does not tell it.
    """

    rights: Sequence[Rights]
    domain_id: int
    now: datetime.datetime
    voyage: datetime.timedelta
    authority_sha256: str = ""


def keystore_faults(keystore: Path, use: KeystoreUse) -> list[KeystoreFault]:
    """All that is wrong with a keystore; empty where it is good.

    Raises:
        LookupError: no signature can be checked here: there is no program ``openssl``.
    """
    enclaves = keystore / ENCLAVES
    if not enclaves.is_dir():
        expected = f"expected the folders {_PUBLIC} and {ENCLAVES}, as 'ros2 security create_keystore' makes them"
        return [KeystoreFault(f"{keystore}: is no keystore: {expected}", "set ROS_SECURITY_KEYSTORE to the ship's")]
    there = sorted("/" + path.parent.relative_to(enclaves).as_posix() for path in enclaves.glob("**/cert.pem"))
    nodes = [rights.enclave for rights in use.rights if rights.is_needed]
    if there and not set(there) & {rights.enclave for rights in use.rights}:
        text = f"{enclaves}: a keystore of another ship: it has {_few(there)}, expected {_few(nodes)}"
        return [KeystoreFault(text, "set ROS_SECURITY_KEYSTORE to this ship's, or --namespace to its own")]
    used = [rights for rights in use.rights if rights.enclave in there or rights.is_needed]
    folders = [enclaves / rights.enclave.lstrip("/") for rights in used]
    faults = list(_authority_faults([keystore / _PUBLIC, *folders], use.authority_sha256))
    for folder, rights in zip(folders, used, strict=True):
        faults += _Enclave(folder, rights, use).faults()
    return list(dict.fromkeys(faults))


def require_keystore(keystore: Path, use: KeystoreUse) -> list[str]:
    """Refuse a keystore with which the suite could not run as this ship's; returns what else is wrong, one line each.

    What is about policies does not keep a suite down that is started again at sea.

    Raises:
        BadInput: names the file, the line and what was expected.
    """
    try:
        faults = keystore_faults(keystore, use)
    except LookupError:
        return ["signatures of the keystore are not checked: there is no program openssl"]
    for fault in faults:
        if fault.is_error and not fault.of_policy:
            raise BadInput(f"{fault.text}: not started; {fault.advice}")
    return [fault.text for fault in faults]


def _authority_faults(folders: Sequence[Path], told: str) -> Iterator[KeystoreFault]:
    """Identities of another ship: all folders must hold one authority, the one that the ship tells, else the first."""
    paths = [path for folder in folders if (path := folder / _IDENTITY_CA).is_file()]
    expected, by = told.replace(":", "").lower(), "machine.authority_sha256"
    for path in paths:
        try:
            digest = _read_certificate(path).fingerprint(SHA256()).hex()
        except BadInput:
            continue  # told with its enclave
        if not expected:
            expected, by = digest, str(path)
        if digest != expected:
            text = f"{path}: an authority of another ship: its SHA-256 is {digest}, expected {expected}, as in {by}"
            yield KeystoreFault(text, "take the enclave from this ship's own keystore")


class _Enclave:
    """One enclave's files against its rights."""

    def __init__(self, folder: Path, rights: Rights, use: KeystoreUse) -> None:
        self._folder, self._rights, self._use = folder, rights, use

    def faults(self) -> Iterator[KeystoreFault]:
        missing = [name for name in _FILES if not (self._folder / name).is_file()]
        if missing:
            advice = f"ros2 security create_enclave KEYSTORE {self._rights.enclave}"
            yield KeystoreFault(f"{self._folder}: has no {', '.join(missing)}", advice)
        parts = (
            (self._certificate_faults, {_CERTIFICATE, _IDENTITY_CA}),
            (self._key_faults, {_CERTIFICATE, _KEY}),
            (self._governance_faults, {_GOVERNANCE, _PERMISSIONS_CA}),
            (self._permission_faults, {_PERMISSIONS, _PERMISSIONS_CA}),
        )
        for look, needed in parts:
            if needed.isdisjoint(missing):
                try:
                    yield from look()
                except BadInput as problem:
                    yield KeystoreFault(str(problem), "make the enclave anew, with the ship's own keystore")

    @cached_property
    def _certificate(self) -> x509.Certificate:
        return _read_certificate(self._folder / _CERTIFICATE)

    def _certificate_faults(self) -> Iterator[KeystoreFault]:
        path, authority_path = self._folder / _CERTIFICATE, self._folder / _IDENTITY_CA
        authority = _read_certificate(authority_path)
        subject, expected = _common_name(self._certificate.subject), self._rights.enclave
        if subject != expected:
            text = f"{path}: subject is 'CN={subject}': expected 'CN={expected}'"
            yield KeystoreFault(text, f"make it anew: ros2 security create_enclave KEYSTORE {expected}")
        if not _is_issued_by(self._certificate, authority):
            issuer = _common_name(self._certificate.issuer)
            text = (
                f"{path}: a certificate of another ship: not signed by {authority_path} "
                f"('CN={_common_name(authority.subject)}'), its issuer is 'CN={issuer}'"
            )
            yield KeystoreFault(text, "take the enclave from this ship's own keystore")
        for certificate, name in ((self._certificate, path), (authority, authority_path)):
            yield from self._date_faults(name, *_validity(certificate))

    def _key_faults(self) -> Iterator[KeystoreFault]:
        path = self._folder / _KEY
        mode = path.stat().st_mode
        if mode & (_OTHERS_READ | _OTHERS_WRITE):
            text = f"{path}: mode {mode & 0o777:o}: others may read or change the private key"
            yield KeystoreFault(text, f"chmod 600 {path}")
        if not os.access(path, os.R_OK):
            yield KeystoreFault(f"{path}: cannot be read by this user", "run as the user that owns the keystore")
            return
        try:
            key = load_pem_private_key(path.read_bytes(), password=None)
        except (ValueError, TypeError) as problem:
            raise BadInput("is no private key without a password (PEM)", file=path) from problem
        if _public_bytes(key.public_key()) != _public_bytes(self._certificate.public_key()):
            text = f"{path}: is not the key of {self._folder / _CERTIFICATE}"
            yield KeystoreFault(text, f"make both anew: ros2 security create_enclave KEYSTORE {self._rights.enclave}")

    def _governance_faults(self) -> Iterator[KeystoreFault]:
        path = self._folder / _GOVERNANCE
        file = read_signed(path)
        if (fault := signature_fault(path, self._folder / _PERMISSIONS_CA)) is not None:
            yield KeystoreFault(f"{path}: {fault}", "take governance.p7s from this ship's own keystore")
        for problem in governance_faults(file, self._use.domain_id):
            yield KeystoreFault(str(problem), "sign governance.xml of 'policies' anew", of_policy=True)

    def _permission_faults(self) -> Iterator[KeystoreFault]:
        path = self._folder / _PERMISSIONS
        file = read_signed(path)
        if (fault := signature_fault(path, self._folder / _PERMISSIONS_CA)) is not None:
            yield KeystoreFault(f"{path}: {fault}", "sign the permissions with this ship's permissions authority")
        permissions = read_permissions(file)
        expected = f"CN={self._rights.enclave}"
        if permissions.subject != expected:
            place = f"{path}:{file.line_of('<subject_name>') or 1}"
            text = f"{place}: subject_name is '{permissions.subject}': expected '{expected}'"
            yield KeystoreFault(text, "these are permissions of another enclave or ship: make them anew")
        yield from self._date_faults(path, permissions.not_before, permissions.not_after)
        advice = "make the policies anew: ./ros2run ship_bringup policies"
        for text in policy_faults(permissions, self._rights, self._use.domain_id):
            yield KeystoreFault(f"{path}: {text}", advice, of_policy=True)

    def _date_faults(
        self, path: Path, first: datetime.datetime, last: datetime.datetime
    ) -> Iterator[KeystoreFault]:
        now, end = self._use.now, self._use.now + self._use.voyage
        if not first <= now:
            yield KeystoreFault(f"{path}: not_before {first:%Y-%m-%d %H:%M} UTC is still to come", "set the clock")
        if not last > now:
            yield KeystoreFault(f"{path}: not_after {last:%Y-%m-%d %H:%M} UTC is over", "make it anew")
        elif not last > end:
            days = (last - now).total_seconds() / 86400.0
            text = f"{path}: not_after {last:%Y-%m-%d} is in {days:.1f} days, before the voyage ends"
            yield KeystoreFault(text, "make it anew before the voyage", is_error=False)


def policy_faults(permissions: Permissions, rights: Rights, domain_id: int) -> Iterator[str]:
    """Where permissions allow less or more than the code declares, or were made of other declarations."""
    if not permissions.is_for(domain_id):
        yield f"domains: no rule for domain {domain_id}, in which the suite runs"
        return
    wanted = {"publish": published(rights), "subscribe": subscribed(rights)}
    for action, topics in wanted.items():
        denied = [topic for topic in sorted(topics) if not permissions.allow(action, topic, domain_id)]
        if denied:
            yield f"do not cover the code: {action} of {_few(denied)} is not allowed"
        if extra := sorted(permissions.named(action) - topics):
            yield f"allow more than the code declares: {action} of {_few(extra)}"
    if permissions.is_open:
        yield "default is ALLOW: expected DENY, or everybody may do everything"
    if permissions.fingerprint not in ("", rights.fingerprint):
        made, now = permissions.fingerprint[:12], rights.fingerprint[:12]
        yield f"are older than the code, or of another suite file: {FINGERPRINT} {made}, expected {now}"


def _few(names: Iterable[str]) -> str:
    """A few names, and how many more there are."""
    every = list(names)
    more = f" and {len(every) - _MOST_NAMED} more" if len(every) > _MOST_NAMED else ""
    return ", ".join(every[:_MOST_NAMED]) + more


def _read_certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as problem:
        raise BadInput(f"cannot be read: {problem.strerror}", file=path) from problem
    except ValueError as problem:
        raise BadInput("is no certificate (PEM, X.509)", file=path) from problem


def _common_name(name: x509.Name) -> str:
    found = name.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def _is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _validity(certificate: x509.Certificate) -> tuple[datetime.datetime, datetime.datetime]:
    """Begin and end, UTC; cryptography before version 42, as in Ubuntu 24.04, gives them without a time zone."""
    if hasattr(certificate, "not_valid_after_utc"):
        return certificate.not_valid_before_utc, certificate.not_valid_after_utc
    utc = datetime.timezone.utc
    return certificate.not_valid_before.replace(tzinfo=utc), certificate.not_valid_after.replace(tzinfo=utc)


def _public_bytes(key: Any) -> bytes:
    return bytes(key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
