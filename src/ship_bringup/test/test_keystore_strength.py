"""Weak protection in a consistent keystore, for example short keys, writable files or an authority's private key.

The node's certificates are made by the program ``openssl``, because the Python library refuses some of the tested keys
and digests.
"""

import datetime
import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from ship_bringup.checks.check_line import Result
from ship_bringup.checks.network_check import check_keystore
from ship_bringup.security.keystore import KeystoreUse, keystore_faults, require_keystore
from ship_bringup.security.policy_xml import permissions_text
from ship_bringup.security.rights import suite_rights
from ship_bringup.suite.plan import check_nodes
from ship_testing.keystores import DAY, YEAR, Keystore, certificate_of, new_authority, new_key

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no program openssl")

ROOT = Path(__file__).parents[3]
DOMAIN = 7
NODE = "/demo/ship_attitude"
# An hour from now: certificates by openssl begin when they are made, which must be before this time.
NOW = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(hours=1)
RIGHTS = suite_rights(
    [node.adapter for node in check_nodes(ROOT / "examples" / "two_sensors.yaml", "demo")[0]], "demo", False
)
(OF_NODE,) = [rights for rights in RIGHTS if rights.enclave == NODE]
AUTHORITY = new_authority("sros2CA", NOW)


def faults_of(keystore, now=NOW):
    return keystore_faults(keystore.path, KeystoreUse(RIGHTS, DOMAIN, now, 30 * DAY))


def texts_of(keystore, now=NOW):
    texts = [fault.text for fault in faults_of(keystore, now)]
    assert not any("\n" in text for text in texts)
    return texts


def openssl(*arguments):
    subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True)


@pytest.fixture
def keystore(tmp_path):
    store = Keystore(tmp_path / "keystore", AUTHORITY, DOMAIN, NOW).add([OF_NODE])
    assert texts_of(store) == []
    return store


def write_private(path, key):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    path.chmod(0o600)


def issue(keystore, folder, *new_key_options, digest="sha256", extensions="basicConstraints=CA:FALSE"):
    """Give the node a certificate with a key of these options, signed by the authority."""
    ours = folder / "source"
    write_private(ours / "ca.key", AUTHORITY.key)
    Keystore.write_certificate(ours / "ca.pem", AUTHORITY.certificate)
    (ours / "extensions").write_text(extensions)
    key, node = ours / "node.key", keystore.folder(NODE)
    openssl("genpkey", *new_key_options, "-out", key)
    openssl("req", "-new", "-key", key, "-subj", f"/CN={NODE.replace('/', chr(92) + '/')}", "-out", ours / "node.csr")
    openssl("x509", "-req", "-in", ours / "node.csr", "-CA", ours / "ca.pem", "-CAkey", ours / "ca.key", f"-{digest}",
            "-days", 300, "-extfile", ours / "extensions", "-set_serial", 7, "-out", node / "cert.pem")  # fmt: skip
    (node / "key.pem").write_bytes(key.read_bytes())
    (node / "key.pem").chmod(0o600)


P256 = "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:prime256v1"


@pytest.mark.parametrize(
    ("options", "finding"),
    [
        (("-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:1024"), "its RSA key has 1024 bits: expected"),
        (("-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:secp224r1"), "its curve secp224r1 has 224 bits"),
        (("-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:wap-wsg-idm-ecid-wtls8"), "its key cannot be used"),
    ],
)
def test_too_short_key(keystore, tmp_path, options, finding):
    issue(keystore, tmp_path, *options)
    texts = texts_of(keystore)
    assert any(text.startswith(f"{keystore.folder(NODE)}/cert.pem: too weak: {finding}") for text in texts), texts


@pytest.mark.parametrize(
    "options", [("-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:2048"), P256, ("-algorithm", "ED25519")]
)
def test_sufficient_key(keystore, tmp_path, options):
    issue(keystore, tmp_path, *options)
    assert texts_of(keystore) == []


@pytest.mark.parametrize("digest", ["sha1", "sha224"])
def test_certificate_with_short_digest(keystore, tmp_path, digest):
    issue(keystore, tmp_path, *P256, digest=digest)
    expected = f"{keystore.folder(NODE)}/cert.pem: too weak: it is signed with {digest.upper()}: expected SHA-256"
    assert any(text.startswith(expected) for text in texts_of(keystore))


@pytest.mark.parametrize("digest", ["sha1", "sha224"])
def test_permissions_with_short_digest(keystore, tmp_path, digest):
    write_private(tmp_path / "ca.key", AUTHORITY.key)
    Keystore.write_certificate(tmp_path / "ca.pem", AUTHORITY.certificate)
    (tmp_path / "permissions.xml").write_text(permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR))
    out = keystore.folder(NODE) / "permissions.p7s"
    openssl("smime", "-sign", "-text", "-md", digest, "-in", tmp_path / "permissions.xml", "-out", out,
            "-signer", tmp_path / "ca.pem", "-inkey", tmp_path / "ca.key")  # fmt: skip
    expected = f"{out}: too weak: it is signed with {digest.upper()}: expected SHA-256 or longer"
    assert expected in texts_of(keystore)


def test_certificate_that_can_sign_others(keystore, tmp_path):
    issue(keystore, tmp_path, *P256, extensions="basicConstraints=critical,CA:TRUE")
    (text,) = texts_of(keystore)
    assert text.startswith(f"{keystore.folder(NODE)}/cert.pem: CA:TRUE: the program could make certificates itself")


@pytest.mark.parametrize("name", ["identity_ca.cert.pem", "permissions_ca.cert.pem"])
def test_expired_authority(keystore, name):
    """The enclave has an expired certificate of the ship's authority, with the key of the valid certificate."""
    old = certificate_of("sros2CA", AUTHORITY.key, now=NOW - YEAR - 2 * DAY)
    Keystore.write_certificate(keystore.folder(NODE) / name, old)
    (text,) = [text for text in texts_of(keystore) if text.startswith(f"{keystore.folder(NODE)}/{name}: ")]
    assert "not_after " in text
    assert text.endswith("UTC has passed")


@pytest.mark.parametrize("place", ["private/ca.key.pem", "public/old.pem", "enclaves/demo/ship_attitude/spare"])
def test_private_key_of_the_authority(keystore, place):
    path = keystore.path / place
    write_private(path, AUTHORITY.key)
    (text,) = texts_of(keystore)
    expected = "the private key of the authority 'CN=sros2CA': whoever reads it can make certificates of this ship"
    assert text == f"{path}: {expected}"
    # The start is not refused, so that a suite can be started again at sea; the key is removed ashore.
    assert require_keystore(keystore.path, KeystoreUse(RIGHTS, DOMAIN, NOW, 30 * DAY)) == [text]
    (row, *_) = check_keystore(str(keystore.path), KeystoreUse(RIGHTS, DOMAIN, NOW, 30 * DAY), False)
    assert row.result is Result.FAIL


def test_links_to_one_key_are_one_fault(keystore):
    """The links are those that ``ros2 security`` makes."""
    write_private(keystore.path / "private" / "ca.key.pem", AUTHORITY.key)
    for name in ("identity_ca.key.pem", "permissions_ca.key.pem"):
        (keystore.path / "private" / name).symlink_to("ca.key.pem")
    assert len(texts_of(keystore)) == 1


def test_unknown_private_key_outside_the_enclaves(keystore):
    write_private(keystore.path / "private" / "ca.key.pem", new_key())
    (text,) = texts_of(keystore)
    assert "the private key of a certificate authority, by its place" in text


@pytest.mark.parametrize(
    ("place", "mode", "users", "harm"),
    [
        ("", 0o777, "all users", "replace the files in it"),
        ("enclaves/demo", 0o757, "all users", "replace the files in it"),
        ("enclaves/demo/ship_attitude", 0o775, "its group", "replace the files in it"),
        ("enclaves/demo/ship_attitude/permissions.p7s", 0o666, "all users", "change it"),
        ("enclaves/demo/ship_attitude/cert.pem", 0o664, "its group", "change it"),
    ],
)
def test_folders_and_files_writable_by_others(keystore, place, mode, users, harm):
    path = keystore.path / place
    path.chmod(mode)
    (fault,) = faults_of(keystore)
    assert fault.text == f"{path}: mode {mode:o}: {users} may {harm}"
    assert fault.is_error == (users == "all users")
    assert fault.advice == f"chmod go-w {path}"
