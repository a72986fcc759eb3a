"""A valid keystore, and faults of a keystore, each reported in one line with the file and the reason."""

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from ship_bags.errors import BadInput
from ship_bringup.checks.check_line import Result
from ship_bringup.checks.network_check import check_keystore
from ship_bringup.security.keystore import KeystoreUse, keystore_faults, require_keystore
from ship_bringup.security.policy_xml import governance_text, permissions_text
from ship_bringup.security.rights import suite_rights
from ship_bringup.suite.plan import check_nodes
from ship_testing.keystores import DAY, NOW, YEAR, Keystore, certificate_of, new_authority, new_key

ROOT = Path(__file__).parents[3]
DOMAIN = 7
NODE = "/demo/ship_attitude"


def rights_in(namespace, is_locked=False):
    nodes, _ = check_nodes(ROOT / "examples" / "two_sensors.yaml", namespace)
    return suite_rights([node.adapter for node in nodes], namespace, is_locked)


RIGHTS = rights_in("demo")
USED = [rights for rights in RIGHTS if rights.enclave in (NODE, "/demo/monitor")]
(OF_NODE,) = [rights for rights in RIGHTS if rights.enclave == NODE]
AUTHORITY, OTHER_AUTHORITY = new_authority("sros2CA"), new_authority("the other ship")


def use(**changes):
    given = KeystoreUse(RIGHTS, DOMAIN, NOW, 30 * DAY)
    return dataclasses.replace(given, **changes)


@pytest.fixture
def keystore(tmp_path):
    return Keystore(tmp_path / "keystore", AUTHORITY, DOMAIN).add(USED)


def single_fault(faults):
    (fault,) = faults
    assert "\n" not in fault.text
    return fault


def test_valid_keystore_has_no_fault(keystore):
    assert keystore_faults(keystore.path, use()) == []
    rows = list(check_keystore(str(keystore.path), use(), True))
    assert [(row.check, row.result) for row in rows] == [("keystore", Result.OK), ("policies", Result.OK)]
    assert "2 enclaves" in rows[0].finding


def test_folder_that_is_no_keystore(tmp_path):
    fault = single_fault(keystore_faults(tmp_path, use()))
    assert re.search(r"is not a keystore: expected the folders public and enclaves", fault.text)


def test_keystore_of_another_ship_by_enclaves(tmp_path):
    other = Keystore(tmp_path / "keystore", OTHER_AUTHORITY, DOMAIN).add(rights_in("aurora")[:2])
    fault = single_fault(keystore_faults(other.path, use()))
    text = "a keystore of another ship: it has /aurora/alerts, /aurora/ship_attitude, expected /demo/ship_attitude"
    assert fault.text == f"{other.path}/enclaves: {text}"
    assert fault.is_error


def test_enclave_of_another_ship_by_authority(keystore):
    key = new_key()
    keystore.write_certificate(keystore.folder(NODE) / "cert.pem", certificate_of(NODE, key, OTHER_AUTHORITY))
    keystore.write_key(NODE, key)
    fault = single_fault(keystore_faults(keystore.path, use()))
    path = keystore.folder(NODE) / "cert.pem"
    assert fault.text.startswith(f"{path}: a certificate of another ship: not signed by ")
    assert "'CN=sros2CA'" in fault.text
    assert fault.text.endswith("its issuer is 'CN=the other ship'")


def test_authority_with_the_same_name_and_another_key(keystore):
    namesake, key = new_authority("sros2CA"), new_key()
    keystore.write_certificate(keystore.folder(NODE) / "cert.pem", certificate_of(NODE, key, namesake))
    keystore.write_key(NODE, key)
    assert "not signed by" in single_fault(keystore_faults(keystore.path, use())).text


def test_whole_enclave_of_another_ship(keystore, tmp_path):
    """The enclave is consistent in itself: certificate, key, signatures and name."""
    other = Keystore(tmp_path / "other", OTHER_AUTHORITY, DOMAIN).add(USED)
    monitor = keystore.folder("/demo/monitor")
    shutil.rmtree(monitor)
    shutil.copytree(other.folder("/demo/monitor"), monitor)
    ours, theirs = (each.certificate.fingerprint(hashes.SHA256()).hex() for each in (AUTHORITY, OTHER_AUTHORITY))
    fault = single_fault(keystore_faults(keystore.path, use()))
    text = f"an authority of another ship: its SHA-256 is {theirs}, expected {ours}, as in {keystore.folder(NODE)}"
    assert fault.text == f"{monitor}/identity_ca.cert.pem: {text}/identity_ca.cert.pem"


def test_whole_keystore_of_another_ship_by_configured_authority(keystore):
    fingerprint = AUTHORITY.certificate.fingerprint(hashes.SHA256()).hex(":").upper()
    assert keystore_faults(keystore.path, use(authority_sha256=fingerprint)) == []
    other = OTHER_AUTHORITY.certificate.fingerprint(hashes.SHA256()).hex()
    faults = keystore_faults(keystore.path, use(authority_sha256=other))
    assert len(faults) == len(USED)
    assert all(f"expected {other}, as in machine.authority_sha256" in fault.text for fault in faults)


def test_keystore_of_another_ship_refuses_the_start(tmp_path):
    other = Keystore(tmp_path / "keystore", OTHER_AUTHORITY, DOMAIN).add(rights_in("aurora")[:2])
    text = r"/enclaves: a keystore of another ship: it has /aurora/alerts, .*: not started; set ROS_SECURITY_KEYSTORE"
    with pytest.raises(BadInput, match=text) as refused:
        require_keystore(other.path, use())
    assert "\n" not in str(refused.value)


def test_old_policy_is_a_warning_at_the_start(keystore):
    assert require_keystore(keystore.path, use()) == []
    keystore.permit(NODE, dataclasses.replace(OF_NODE, declarations=()))
    (text,) = require_keystore(keystore.path, use())
    assert "are older than the code" in text


def test_permissions_of_another_ship(keystore):
    other = dataclasses.replace(OF_NODE, enclave="/aurora/ship_attitude")
    keystore.permit(NODE, other)
    faults = keystore_faults(keystore.path, use())
    path = keystore.folder(NODE) / "permissions.p7s"
    line = next(n for n, text in enumerate(path.read_text().splitlines(), 1) if "<subject_name>" in text)
    (subject,) = [fault for fault in faults if "subject_name" in fault.text]
    expected = "subject_name is 'CN=/aurora/ship_attitude': expected 'CN=/demo/ship_attitude'"
    assert subject.text == f"{path}:{line}: {expected}"


def test_certificate_for_another_enclave(keystore):
    key = new_key()
    certificate = certificate_of("/demo/monitor", key, AUTHORITY)
    keystore.write_certificate(keystore.folder(NODE) / "cert.pem", certificate)
    keystore.write_key(NODE, key)
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert "subject is 'CN=/demo/monitor': expected 'CN=/demo/ship_attitude'" in fault.text


def test_missing_enclave_of_a_node_and_of_a_tool(tmp_path):
    (monitor,) = [rights for rights in USED if rights.enclave == "/demo/monitor"]
    without_node = Keystore(tmp_path / "a", AUTHORITY, DOMAIN).add([monitor])
    fault = single_fault(keystore_faults(without_node.path, use()))
    assert "/demo/ship_attitude: has no identity_ca.cert.pem" in fault.text
    assert fault.advice == "ros2 security create_enclave KEYSTORE /demo/ship_attitude"
    # Tools and drivers, with their keys, may be on other computers.
    assert keystore_faults(Keystore(tmp_path / "b", AUTHORITY, DOMAIN).add([OF_NODE]).path, use()) == []


def test_missing_file_is_named(keystore):
    (keystore.folder(NODE) / "key.pem").unlink()
    assert single_fault(keystore_faults(keystore.path, use())).text == f"{keystore.folder(NODE)}: has no key.pem"


@pytest.mark.parametrize(
    ("later", "text", "is_error"),
    [(YEAR - 30 * DAY - DAY, None, None), (YEAR - 29 * DAY, "is in 29.0 days, before the voyage ends", False),
     (YEAR, "has passed", True), (YEAR + DAY, "has passed", True), (-2 * DAY, "is in the future", True)],
)  # fmt: skip
def test_dates_of_certificates_and_permissions(keystore, later, text, is_error):
    faults = keystore_faults(keystore.path, use(now=NOW + later))
    if text is None:
        assert faults == []
        return
    # Certificate and permissions of both enclaves, and their authority once.
    assert len(faults) == 5
    assert all(text in fault.text and fault.is_error == is_error for fault in faults)


def test_permissions_may_end_before_the_certificate(keystore):
    keystore.permit(NODE, OF_NODE, 2 * DAY)
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert "permissions.p7s: not_after 2026-06-03 is in 2.0 days" in fault.text


def test_key_of_another_certificate(keystore):
    keystore.write_key(NODE, new_key())
    path = keystore.folder(NODE) / "key.pem"
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert fault.text == f"{path}: is not the key of {path.parent}/cert.pem"


@pytest.mark.parametrize("mode", [0o644, 0o620, 0o602])
def test_key_that_others_may_read_or_change(keystore, mode):
    path = keystore.folder(NODE) / "key.pem"
    path.chmod(mode)
    assert single_fault(keystore_faults(keystore.path, use())).text.startswith(f"{path}: mode {mode:o}: others may")
    path.chmod(0o640)
    assert keystore_faults(keystore.path, use()) == []


@pytest.mark.parametrize("name", ["cert.pem", "key.pem", "identity_ca.cert.pem", "permissions.p7s", "governance.p7s"])
def test_unreadable_file_is_reported(keystore, name):
    path = keystore.folder(NODE) / name
    path.write_bytes(b"\x00\xffrubbish")
    faults = keystore_faults(keystore.path, use())
    assert faults
    assert any(fault.text.startswith(str(path)) and re.search("is no|is not signed", fault.text) for fault in faults)


@pytest.mark.parametrize("name", ["permissions.p7s", "governance.p7s"])
def test_changed_text_breaks_the_signature(keystore, name):
    path = keystore.folder(NODE) / name
    changed = path.read_bytes().replace(b"<id>7</id>", b"<id>8</id>")
    path.write_bytes(changed)
    faults = keystore_faults(keystore.path, use(domain_id=8))
    assert any(f"{path}: its signature is not that of" in fault.text for fault in faults)


@pytest.mark.parametrize("name", ["permissions.p7s", "governance.p7s"])
def test_signature_of_another_ship(keystore, name):
    path = keystore.folder(NODE) / name
    text = governance_text(DOMAIN) if name.startswith("g") else permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR)
    keystore.sign(path, text, OTHER_AUTHORITY)
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert fault.text.startswith(f"{path}: its signature is not that of {path.parent}/permissions_ca.cert.pem")


@pytest.mark.parametrize(
    ("right", "wrong", "expected"),
    [("grant", "gift", "has no grant"), ("subject_name>", "name>", "has no subject_name"),
     ("2027-06-01T12:00:00", "next year", "not_after is 'next year': expected a date as 2026-05-01T00:00:00"),
     ("<default>DENY</default>", "", "has no default"), ("</dds>", "", "is not XML")],
)  # fmt: skip
def test_signed_permissions_with_invalid_content(keystore, right, wrong, expected):
    text = permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR)
    assert right in text
    keystore.sign(keystore.folder(NODE) / "permissions.p7s", text.replace(right, wrong))
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert expected in fault.text
    assert fault.text.startswith(f"{keystore.folder(NODE)}/permissions.p7s")


def test_too_large_file_is_not_read(keystore):
    path = keystore.folder(NODE) / "permissions.p7s"
    with path.open("r+b") as file:
        file.truncate(1 << 40)
    assert "is larger than 4000000 bytes" in single_fault(keystore_faults(keystore.path, use())).text


def test_permissions_of_another_domain(keystore):
    faults = keystore_faults(keystore.path, use(domain_id=8))
    assert len(faults) == 4
    assert all("no rule for domain 8, in which the suite runs" in fault.text for fault in faults)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [("unauthenticated_participants>false", "unauthenticated_participants>true"),
     ("join_access_control>true", "join_access_control>false"),
     ("read_access_control>true", "read_access_control>false"),
     ("write_access_control>true", "write_access_control>false")],
)  # fmt: skip
def test_ineffective_governance(keystore, right, wrong):
    text = governance_text(DOMAIN)
    assert right in text
    path = keystore.folder(NODE) / "governance.p7s"
    keystore.sign(path, text.replace(right, wrong))
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert re.search(rf"governance\.p7s:\d+: \w*{wrong.split('>')[0]} is {wrong.split('>')[1]}: expected", fault.text)
    assert fault.of_policy


def test_outdated_policies(keystore):
    """Policies of code with one topic less are reported twice: for the missing permission and for the fingerprint."""
    older = dataclasses.replace(OF_NODE, publishes=OF_NODE.publishes - {"/demo/ship/integrity"})
    keystore.permit(NODE, older)
    texts = [fault.text for fault in keystore_faults(keystore.path, use())]
    assert any("do not cover the code: publish of rt/demo/ship/integrity is not allowed" in text for text in texts)
    assert any(f"are older than the code, or of another suite file: fingerprint {older.fingerprint[:12]}" in text
               for text in texts)  # fmt: skip
    assert len(texts) == 2


def test_policies_from_other_declarations(keystore):
    keystore.permit(NODE, dataclasses.replace(OF_NODE, declarations=OF_NODE.declarations[1:]))
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert "are older than the code" in fault.text
    assert fault.of_policy


def test_policies_of_another_program_without_fingerprint(keystore):
    text = permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR)
    keystore.sign(keystore.folder(NODE) / "permissions.p7s", re.sub(r"<!--.*-->\n", "", text))
    assert keystore_faults(keystore.path, use()) == []


def test_policies_that_allow_too_much(keystore):
    """First, publication on every topic is allowed; then the default is ALLOW."""
    text = permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR)
    wide = text.replace("<topic>rt/rosout</topic>", "<topic>rt/*</topic>")
    keystore.sign(keystore.folder(NODE) / "permissions.p7s", wide)
    fault = single_fault(keystore_faults(keystore.path, use()))
    assert "allow more than the code declares: publish of rt/*" in fault.text
    keystore.sign(keystore.folder(NODE) / "permissions.p7s", text.replace("DENY", "ALLOW"))
    assert "default is ALLOW: expected DENY" in single_fault(keystore_faults(keystore.path, use())).text


def test_earlier_deny_rule_takes_precedence(keystore):
    text = permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR)
    denied = "<publish><topics><topic>rt/demo/ship/attitude</topic></topics></publish>"
    rule = f"<deny_rule><domains><id_range><min>0</min></id_range></domains>{denied}</deny_rule>"
    keystore.sign(keystore.folder(NODE) / "permissions.p7s", text.replace("<allow_rule>", rule + "<allow_rule>"))
    assert "publish of rt/demo/ship/attitude is not allowed" in single_fault(keystore_faults(keystore.path, use())).text


def test_locked_and_unlocked_policies_differ(tmp_path):
    def param(locked):
        return [rights for rights in rights_in("demo", locked) if rights.enclave == "/demo/param"]

    store = Keystore(tmp_path / "keystore", AUTHORITY, DOMAIN).add([OF_NODE, *param(False)])
    assert keystore_faults(store.path, use()) == []
    texts = [fault.text for fault in keystore_faults(store.path, use(rights=rights_in("demo", True)))]
    assert any("allow more than the code declares: publish of rq/demo/alerts/set_parameters_atomicallyRequest" in text
               for text in texts)  # fmt: skip


def test_file_signed_by_hand_as_documented(keystore, tmp_path):
    text, certificate, key = (tmp_path / name for name in ("permissions.xml", "ca.cert.pem", "ca.key.pem"))
    text.write_text(permissions_text(OF_NODE, DOMAIN, NOW - DAY, NOW + YEAR))
    keystore.write_certificate(certificate, AUTHORITY.certificate)
    key.write_bytes(AUTHORITY.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    out = keystore.folder(NODE) / "permissions.p7s"
    out.unlink()
    command = ["openssl", "smime", "-sign", "-text", "-in", text, "-out", out, "-signer", certificate, "-inkey", key]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    assert keystore_faults(keystore.path, use()) == []


def test_several_faults_at_once(keystore):
    keystore.write_key(NODE, new_key(), mode=0o644)
    keystore.permit(NODE, OF_NODE, -DAY / 2)
    (keystore.folder("/demo/monitor") / "cert.pem").write_text("rubbish")
    texts = " ".join(fault.text for fault in keystore_faults(keystore.path, use(domain_id=8)))
    for part in ("mode 644", "is not the key of", "has passed", "no rule for domain 8", "is not a certificate"):
        assert part in texts


def test_missing_openssl_fails_only_if_security_is_required(keystore, monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    (row,) = check_keystore(str(keystore.path), use(), False)
    assert (row.result, row.advice) == (Result.NOT_CHECKED, "sudo apt install openssl")
    (row,) = check_keystore(str(keystore.path), use(), True)
    assert row.result is Result.FAIL


def test_rows_of_a_faulty_keystore_fail(keystore):
    keystore.permit(NODE, dataclasses.replace(OF_NODE, publishes=frozenset()))
    (keystore.folder("/demo/monitor") / "key.pem").chmod(0o644)
    rows = list(check_keystore(str(keystore.path), use(), False))
    assert {(row.check, row.result) for row in rows} == {("keystore", Result.FAIL), ("policies", Result.FAIL)}
