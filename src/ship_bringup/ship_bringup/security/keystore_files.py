"""Files of a keystore: their permissions, and private keys that must not be aboard."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from ship_bringup.security.certificates import certificate_key, common_name, public_bytes
from ship_bringup.security.keystore_fault import KeystoreFault

_KEY = "key.pem"
_OTHERS_READ = 0o004
_GROUP_WRITE, _OTHERS_WRITE = 0o020, 0o002
_LARGEST_KEY_BYTES = 100_000
_KEY_MARK = b"PRIVATE KEY-----"


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
