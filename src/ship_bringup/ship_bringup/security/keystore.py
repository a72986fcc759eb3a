"""Checks of a keystore of ``ros2 security`` before a suite starts with it.

Each fault is one text line with file, line and what was expected; the keystore is not changed. A keystore of another
ship is detected by its enclaves, its authority or the subjects of its certificates.
"""

import datetime
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from ship_bags.command_line import launcher
from ship_bags.errors import BadInput
from ship_bringup.security.keystore_files import (
    KeystoreFault,
    authority_key_faults,
    certificate_key,
    common_name,
    is_authority,
    is_issued_by,
    mode_faults,
    public_bytes,
    read_certificate,
    validity,
    weaknesses,
)
from ship_bringup.security.policy_xml import (
    FINGERPRINT,
    Permissions,
    governance_faults,
    read_permissions,
    read_signed,
    read_topics,
    signature_digest,
    signature_fault,
    written_topics,
)
from ship_bringup.security.rights import Rights

ENCLAVES = "enclaves"
_PUBLIC = "public"
_IDENTITY_CA, _PERMISSIONS_CA = "identity_ca.cert.pem", "permissions_ca.cert.pem"
_CERTIFICATE, _KEY, _GOVERNANCE, _PERMISSIONS = "cert.pem", "key.pem", "governance.p7s", "permissions.p7s"
_FILES = _IDENTITY_CA, _PERMISSIONS_CA, _CERTIFICATE, _KEY, _GOVERNANCE, _PERMISSIONS
_MAX_NAMED = 3
_STRONG_DIGESTS = "sha256", "sha384", "sha512"


@dataclass(frozen=True)
class KeystoreUse:
    """Requirements of a suite on its keystore.

    Attributes:
        rights: rights of all programs of the suite. Enclaves that this computer does not need may be missing.
        domain_id: ROS_DOMAIN_ID.
        now: current time, UTC.
        voyage: time after `now` during which certificates and permissions must stay valid.
        authority_sha256: SHA-256 of the ship's identity authority, in hexadecimal; empty if not configured.
    """

    rights: Sequence[Rights]
    domain_id: int
    now: datetime.datetime
    voyage: datetime.timedelta
    authority_sha256: str = ""


def keystore_faults(keystore: Path, use: KeystoreUse) -> list[KeystoreFault]:
    """Return the faults of the parts of a keystore that a suite uses; the list may be empty.

    If the folder is no keystore, or has only enclaves of another suite, this fault is the only one.

    Raises:
        LookupError: signatures cannot be checked because the program ``openssl`` is missing.
    """
    enclaves = keystore / ENCLAVES
    if not enclaves.is_dir():
        expected = f"expected the folders {_PUBLIC} and {ENCLAVES}, as 'ros2 security create_keystore' makes them"
        advice = "set ROS_SECURITY_KEYSTORE to the ship's keystore"
        return [KeystoreFault(f"{keystore}: is not a keystore: {expected}", advice)]
    existing = sorted("/" + path.parent.relative_to(enclaves).as_posix() for path in enclaves.glob("**/cert.pem"))
    nodes = [rights.enclave for rights in use.rights if rights.is_needed]
    if existing and not set(existing) & {rights.enclave for rights in use.rights}:
        others = f"it has {_shortened_list(existing)}, expected {_shortened_list(nodes)}"
        text = f"{enclaves}: a keystore of another ship: {others}"
        advice = "set ROS_SECURITY_KEYSTORE to this ship's keystore, or --namespace to the namespace of the keystore"
        return [KeystoreFault(text, advice)]
    used = [rights for rights in use.rights if rights.enclave in existing or rights.is_needed]
    folders = [enclaves / rights.enclave.lstrip("/") for rights in used]
    authorities = _authorities([keystore / _PUBLIC, *folders])
    faults = list(_foreign_authority_faults([keystore / _PUBLIC, *folders], use.authority_sha256))
    for path, authority in authorities.items():
        faults += _weakness_faults(path, authority)
        faults += _date_faults(use, path, *validity(authority))
    faults += authority_key_faults(keystore, list(authorities.values()))
    faults += mode_faults(keystore, [keystore / _PUBLIC, *folders], _FILES)
    for folder, rights in zip(folders, used, strict=True):
        faults += _Enclave(folder, rights, use).faults()
    return list(dict.fromkeys(faults))


def require_keystore(keystore: Path, use: KeystoreUse) -> list[str]:
    """Raise an error if the suite cannot start with a keystore; else return the keystore's faults, one line each.

    Policy faults, weaknesses and warnings are only returned, so that they do not prevent a restart at sea. If the
    program ``openssl`` is needed but missing, only a line about ``openssl`` is returned.

    Raises:
        BadInput: the suite cannot start; the text contains the file, the line and what was expected.
    """
    try:
        faults = keystore_faults(keystore, use)
    except LookupError:
        return ["signatures of the keystore are not checked: there is no program openssl"]
    for fault in faults:
        if fault.is_error and not fault.of_policy and not fault.is_weakness:
            raise BadInput(f"{fault.text}: not started; {fault.advice}")
    return [fault.text for fault in faults]


def _authorities(folders: Iterable[Path]) -> dict[Path, x509.Certificate]:
    """Return path → certificate of the authorities in some folders; for equal certificates, only the first path."""
    found: dict[x509.Certificate, Path] = {}
    for path in (folder / name for folder in folders for name in (_IDENTITY_CA, _PERMISSIONS_CA)):
        with suppress(BadInput):  # an unreadable file of an enclave is reported by _Enclave
            found.setdefault(read_certificate(path), path)
    return {path: certificate for certificate, path in found.items()}


def _weakness_faults(path: Path, certificate: x509.Certificate) -> Iterator[KeystoreFault]:
    for text in weaknesses(certificate):
        advice = "create it again with 'ros2 security', and everything signed with it"
        yield KeystoreFault(f"{path}: too weak: {text}", advice, is_weakness=True)


def _date_faults(
    use: KeystoreUse, path: Path, first: datetime.datetime, last: datetime.datetime
) -> Iterator[KeystoreFault]:
    now, end = use.now, use.now + use.voyage
    if not first <= now:
        yield KeystoreFault(f"{path}: not_before {first:%Y-%m-%d %H:%M} UTC is in the future", "set the clock")
    if not last > now:
        yield KeystoreFault(f"{path}: not_after {last:%Y-%m-%d %H:%M} UTC has passed", "create it again")
    elif not last > end:
        days = (last - now).total_seconds() / 86400.0
        text = f"{path}: not_after {last:%Y-%m-%d} is in {days:.1f} days, before the voyage ends"
        yield KeystoreFault(text, "create it again before the voyage", is_error=False)


def _foreign_authority_faults(folders: Sequence[Path], authority_sha256: str) -> Iterator[KeystoreFault]:
    """Yield a fault for each folder with the identity authority of another ship.

    All folders must contain the configured authority or, if none is configured, the authority of the first folder.
    """
    paths = [path for folder in folders if (path := folder / _IDENTITY_CA).is_file()]
    expected, by = authority_sha256.replace(":", "").lower(), "machine.authority_sha256"
    for path in paths:
        try:
            digest = read_certificate(path).fingerprint(SHA256()).hex()
        except BadInput:
            continue  # an unreadable file of an enclave is reported by _Enclave
        if not expected:
            expected, by = digest, str(path)
        if digest != expected:
            text = f"{path}: an authority of another ship: its SHA-256 is {digest}, expected {expected}, as in {by}"
            yield KeystoreFault(text, "take the enclave from this ship's own keystore")


class _Enclave:
    """The files of one enclave, checked against its rights."""

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
        for find_faults, needed in parts:
            if needed.isdisjoint(missing):
                try:
                    yield from find_faults()
                except BadInput as problem:
                    yield KeystoreFault(str(problem), "create the enclave again, with the ship's own keystore")

    @cached_property
    def _certificate(self) -> x509.Certificate:
        return read_certificate(self._folder / _CERTIFICATE)

    def _certificate_faults(self) -> Iterator[KeystoreFault]:
        path, authority_path = self._folder / _CERTIFICATE, self._folder / _IDENTITY_CA
        authority = read_certificate(authority_path)
        subject, expected = common_name(self._certificate.subject), self._rights.enclave
        if subject != expected:
            text = f"{path}: subject is 'CN={subject}': expected 'CN={expected}'"
            yield KeystoreFault(text, f"create it again: ros2 security create_enclave KEYSTORE {expected}")
        if not is_issued_by(self._certificate, authority):
            issuer = common_name(self._certificate.issuer)
            text = (
                f"{path}: a certificate of another ship: not signed by {authority_path} "
                f"('CN={common_name(authority.subject)}'), its issuer is 'CN={issuer}'"
            )
            yield KeystoreFault(text, "take the enclave from this ship's own keystore")
        if is_authority(self._certificate):
            text = f"{path}: CA:TRUE: the program could make certificates itself; expected CA:FALSE"
            advice = f"create it again: ros2 security create_enclave KEYSTORE {expected}"
            yield KeystoreFault(text, advice, is_weakness=True)
        yield from _weakness_faults(path, self._certificate)
        yield from _date_faults(self._use, path, *validity(self._certificate))

    def _key_faults(self) -> Iterator[KeystoreFault]:
        path = self._folder / _KEY
        if not os.access(path, os.R_OK):
            yield KeystoreFault(f"{path}: cannot be read by this user", "run as the user that owns the keystore")
            return
        try:
            key = load_pem_private_key(path.read_bytes(), password=None)
        except (ValueError, TypeError, UnsupportedAlgorithm) as problem:
            raise BadInput("is not a private key without a password (PEM)", file=path) from problem
        if public_bytes(key.public_key()) != certificate_key(self._certificate):
            text = f"{path}: is not the key of {self._folder / _CERTIFICATE}"
            yield KeystoreFault(text, f"make both again: ros2 security create_enclave KEYSTORE {self._rights.enclave}")

    def _governance_faults(self) -> Iterator[KeystoreFault]:
        path = self._folder / _GOVERNANCE
        file = read_signed(path)
        yield from self._signature_faults(path, "take governance.p7s from this ship's own keystore")
        for problem in governance_faults(file, self._use.domain_id):
            yield KeystoreFault(str(problem), "sign governance.xml of 'policies' again", of_policy=True)

    def _permission_faults(self) -> Iterator[KeystoreFault]:
        path = self._folder / _PERMISSIONS
        file = read_signed(path)
        yield from self._signature_faults(path, "sign the permissions with this ship's permissions authority")
        permissions = read_permissions(file)
        expected = f"CN={self._rights.enclave}"
        if permissions.subject != expected:
            place = f"{path}:{file.line_of('<subject_name>') or 1}"
            text = f"{place}: subject_name is '{permissions.subject}': expected '{expected}'"
            yield KeystoreFault(text, "these are permissions of another enclave or ship: create them again")
        yield from _date_faults(self._use, path, permissions.not_before, permissions.not_after)
        advice = f"create the policies again: {launcher()} ship_bringup policies"
        for text in policy_faults(permissions, self._rights, self._use.domain_id):
            yield KeystoreFault(f"{path}: {text}", advice, of_policy=True)

    def _signature_faults(self, path: Path, advice: str) -> Iterator[KeystoreFault]:
        """Yield the faults of a file's signature; ``advice`` is for a signature of another authority."""
        if (fault := signature_fault(path, self._folder / _PERMISSIONS_CA)) is not None:
            yield KeystoreFault(f"{path}: {fault}", advice)
        if (digest := signature_digest(path)) not in ("", *_STRONG_DIGESTS):
            text = f"{path}: too weak: it is signed with {digest.upper()}: expected SHA-256 or longer"
            yield KeystoreFault(text, "sign it again: openssl smime -sign -md sha256", is_weakness=True)


def policy_faults(permissions: Permissions, rights: Rights, domain_id: int) -> Iterator[str]:
    """Yield the faults of permissions: wrong domain, rights unlike those in the code, default ALLOW, out of date."""
    if not permissions.is_for(domain_id):
        yield f"domains: no rule for domain {domain_id}, in which the suite runs"
        return
    wanted = {"publish": written_topics(rights), "subscribe": read_topics(rights)}
    for action, topics in wanted.items():
        denied = [topic for topic in sorted(topics) if not permissions.is_allowed(action, topic, domain_id)]
        if denied:
            yield f"permissions do not cover the code: {action} of {_shortened_list(denied)} is not allowed"
        if extra := sorted(permissions.allowed_topics(action) - topics):
            yield f"permissions allow more than the code declares: {action} of {_shortened_list(extra)}"
    if permissions.allows_by_default:
        yield "default is ALLOW: expected DENY, otherwise nothing is forbidden"
    if permissions.fingerprint not in ("", rights.fingerprint):
        made, now = permissions.fingerprint[:12], rights.fingerprint[:12]
        yield f"permissions are older than the code, or of another suite file: {FINGERPRINT} {made}, expected {now}"


def _shortened_list(names: Iterable[str]) -> str:
    """Return the first three names and the number of further names, as text."""
    every = list(names)
    more = f" and {len(every) - _MAX_NAMED} more" if len(every) > _MAX_NAMED else ""
    return ", ".join(every[:_MAX_NAMED]) + more
