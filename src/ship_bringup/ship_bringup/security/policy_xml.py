"""Policies as XML files: the policy of SROS2, and governance and permissions of OMG DDS Security 1.1.

The policy contains ROS names. Permissions contain the names of ROS 2 in DDS: ``rt/`` before a topic; ``rq/`` and
``Request``, or ``rr/`` and ``Reply``, around a service. Governance and permissions equal the files that ``ros2
security`` makes from the policy. Without ROS, governance and permissions are signed by hand.

Signed governance and permissions are read as Fast DDS reads them, with checks of signature and rules. The signature is
S/MIME (PKCS#7, detached). ``cryptography`` makes such signatures but cannot verify them, so the program ``openssl`` is
used.
"""

import datetime
import email
import fnmatch
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bringup.security.rights import Rights

POLICY_VERSION = "0.2.0"
FINGERPRINT = "fingerprint"
"""Name of :attr:`Rights.fingerprint` as an attribute of a policy's metadata and in a comment of permissions."""

DISCOVERY_TOPIC = "ros_discovery_info"
"""Topic by which participants of rmw_fastrtps exchange their nodes; every enclave needs it."""

_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_"
_ALLOW = "ALLOW"

_LARGEST_BYTES = 4_000_000
_OPENSSL_TIMEOUT_S = 10.0
_ACTIONS = "publish", "subscribe"
_YES, _NO = ("true", "1"), ("false", "0")


def policy_text(all_rights: Sequence[Rights]) -> str:
    """Return the SROS2 policy (policy.xsd 0.2.0), for ``ros2 security generate_artifacts --policy-files``."""
    root = ET.Element("policy", version=POLICY_VERSION)
    enclaves = ET.SubElement(root, "enclaves")
    for rights in all_rights:
        profiles = ET.SubElement(ET.SubElement(enclaves, "enclave", path=rights.enclave), "profiles")
        namespace, _, node = rights.enclave.rpartition("/")
        profile = ET.SubElement(profiles, "profile", ns=namespace or "/", node=node)
        for kind, action, names in (
            ("topic", "publish", rights.publishes),
            ("topic", "subscribe", rights.subscribes),
            ("service", "reply", rights.serves),
            ("service", "request", rights.requests),
        ):
            if names:
                _add_names(ET.SubElement(profile, f"{kind}s", {action: _ALLOW}), kind, names)
        ET.SubElement(profiles, "metadata", {FINGERPRINT: rights.fingerprint})
    return _xml_text(root)


def governance_text(domain_id: int) -> str:
    """Return the governance of a domain: certificates of the ship, encryption and access control are required."""
    root = _dds("governance.xsd")
    rule = ET.SubElement(ET.SubElement(root, "domain_access_rules"), "domain_rule")
    _add_domain(rule, domain_id)
    for name, value in (
        ("allow_unauthenticated_participants", "false"),
        ("enable_join_access_control", "true"),
        ("discovery_protection_kind", "ENCRYPT"),
        ("liveliness_protection_kind", "ENCRYPT"),
        ("rtps_protection_kind", "SIGN"),
    ):
        ET.SubElement(rule, name).text = value
    topics = ET.SubElement(ET.SubElement(rule, "topic_access_rules"), "topic_rule")
    for name, value in (
        ("topic_expression", "*"),
        ("enable_discovery_protection", "true"),
        ("enable_liveliness_protection", "true"),
        ("enable_read_access_control", "true"),
        ("enable_write_access_control", "true"),
        ("metadata_protection_kind", "ENCRYPT"),
        ("data_protection_kind", "ENCRYPT"),
    ):
        ET.SubElement(topics, name).text = value
    return _xml_text(root)


def permissions_text(
    rights: Rights, domain_id: int, not_before: datetime.datetime, not_after: datetime.datetime
) -> str:
    """Return the permissions of one enclave, which deny every topic that is not allowed.

    Args:
        rights: rights of the enclave.
        domain_id: ROS_DOMAIN_ID in which the permissions apply.
        not_before: begin of the validity, UTC.
        not_after: end of the validity, UTC.
    """
    root = _dds("permissions.xsd")
    grant = ET.SubElement(ET.SubElement(root, "permissions"), "grant", name=rights.enclave)
    ET.SubElement(grant, "subject_name").text = f"CN={rights.enclave}"
    validity = ET.SubElement(grant, "validity")
    for name, time in (("not_before", not_before), ("not_after", not_after)):
        ET.SubElement(validity, name).text = time.strftime("%Y-%m-%dT%H:%M:%S")
    rule = ET.SubElement(grant, "allow_rule")
    _add_domain(rule, domain_id)
    for action, names in (("publish", written_topics(rights)), ("subscribe", read_topics(rights))):
        _add_names(ET.SubElement(ET.SubElement(rule, action), "topics"), "topic", names)
    ET.SubElement(grant, "default").text = "DENY"
    comment = f"<!-- {FINGERPRINT} {rights.fingerprint} -->\n"
    head, _, body = _xml_text(root).partition("\n")
    return f"{head}\n{comment}{body}"


def written_topics(rights: Rights) -> frozenset[str]:
    """Return the DDS topics that an enclave writes."""
    own = {f"rt{name}" for name in rights.publishes} | {f"rq{name}Request" for name in rights.requests}
    return frozenset(own | {f"rr{name}Reply" for name in rights.serves} | {DISCOVERY_TOPIC})


def read_topics(rights: Rights) -> frozenset[str]:
    """Return the DDS topics that an enclave reads."""
    own = {f"rt{name}" for name in rights.subscribes} | {f"rr{name}Reply" for name in rights.requests}
    return frozenset(own | {f"rq{name}Request" for name in rights.serves} | {DISCOVERY_TOPIC})


def _dds(schema: str) -> ET.Element:
    names = {
        "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
        "xsi:noNamespaceSchemaLocation": _SCHEMAS + schema,
    }
    return ET.Element("dds", names)


def _add_domain(rule: ET.Element, domain_id: int) -> None:
    ET.SubElement(ET.SubElement(rule, "domains"), "id").text = str(domain_id)


def _add_names(group: ET.Element, kind: str, names: Iterable[str]) -> None:
    for name in sorted(names):
        ET.SubElement(group, kind).text = name


def _xml_text(root: ET.Element) -> str:
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


@dataclass(frozen=True)
class SignedFile:
    """The text inside a signed file.

    Attributes:
        path: the file.
        text: the signed text.
    """

    path: Path
    text: str

    def line_of(self, words: str) -> int | None:
        """Return the number, from 1, of the first line of the file that contains ``words``; None if no line does."""
        whole = self.path.read_text(encoding="utf-8", errors="replace").splitlines()
        return next((number for number, line in enumerate(whole, 1) if words in line), None)

    def root(self) -> ET.Element:
        """Return the root element of the XML.

        Raises:
            BadInput: the text is not XML.
        """
        try:
            return ET.fromstring(self.text.strip())
        except ET.ParseError as problem:
            raise BadInput(f"is not XML: {problem}", file=self.path) from problem


@dataclass(frozen=True)
class _Rule:
    """One rule of permissions, which allows or denies topics in some domains."""

    allows: bool
    domains: ET.Element | None
    topics: dict[str, tuple[str, ...]]

    def applies_to(self, action: str, topic: str, domain_id: int) -> bool:
        patterns = self.topics[action]
        return is_in_domains(self.domains, domain_id) and any(fnmatch.fnmatchcase(topic, each) for each in patterns)


@dataclass(frozen=True)
class Permissions:
    """Permissions of an enclave in its signed file.

    Attributes:
        subject: name that the certificate of the enclave must have, for example ``CN=/demo/ship_attitude``.
        not_before: begin of the validity, UTC.
        not_after: end of the validity, UTC.
        fingerprint: fingerprint of the rights in the permissions; empty if another program has made the permissions.
        rules: rules in order; the first rule that applies to a topic is decisive.
        allows_by_default: True if a topic without a rule is allowed.
    """

    subject: str
    not_before: datetime.datetime
    not_after: datetime.datetime
    fingerprint: str
    rules: tuple[_Rule, ...]
    allows_by_default: bool

    def is_allowed(self, action: str, topic: str, domain_id: int) -> bool:
        """True if a DDS topic may be written (``publish``) or read (``subscribe``) in a domain."""
        return next(
            (rule.allows for rule in self.rules if rule.applies_to(action, topic, domain_id)), self.allows_by_default
        )

    def allowed_topics(self, action: str) -> frozenset[str]:
        """Return the topic expressions of all allow rules, which may contain wildcards."""
        return frozenset(topic for rule in self.rules if rule.allows for topic in rule.topics[action])

    def is_for(self, domain_id: int) -> bool:
        """True if any rule applies in a domain."""
        return any(is_in_domains(rule.domains, domain_id) for rule in self.rules)


def read_signed(path: Path) -> SignedFile:
    """Return the text of a signed file; its signature is checked by :func:`signature_fault`.

    Raises:
        BadInput: the file cannot be read, is too large, or is not in the format S/MIME.
    """
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise BadInput(f"is larger than {_LARGEST_BYTES} bytes: expected governance or permissions", file=path)
        message = email.message_from_bytes(path.read_bytes())
    except OSError as problem:
        raise BadInput(f"cannot be read: {problem.strerror}", file=path) from problem
    parts = [*message.walk()][1:]
    if message.get_content_type() != "multipart/signed" or len(parts) != 2:
        raise BadInput("is not signed: expected S/MIME, as 'ros2 security' and 'openssl smime -sign' do", file=path)
    text = parts[0].as_bytes().decode("utf-8", errors="replace")
    return SignedFile(path, text[max(text.find("<"), 0) :])


def signature_fault(path: Path, authority: Path) -> str | None:
    """Return the fault of the signature of a file; None if the signature is valid.

    Args:
        path: path of the file.
        authority: certificate of the required signer.

    Raises:
        LookupError: there is no program ``openssl`` here.
    """
    # Dates are checked separately, with the remaining days.
    run = _run_openssl("smime", "-verify", "-in", str(path), "-CAfile", str(authority), "-no_check_time", "-text")
    if run.returncode == 0:
        return None
    error_text = run.stderr.decode("utf-8", errors="replace")
    detail = re.search(r"Verify error: ?(.*)", error_text) or re.search(r":((?:digest|signature) failure)", error_text)
    return f"its signature is not that of {authority}" + (f" ({detail[1].strip()})" if detail else "")


def signature_digest(path: Path) -> str:
    """Return the digest with which a file was signed, as named by openssl; empty if the signature cannot be read.

    Raises:
        LookupError: there is no program ``openssl`` here.
    """
    run = _run_openssl("cms", "-cmsout", "-print", "-noout", "-inform", "SMIME", "-in", str(path))
    signers = run.stdout.decode("utf-8", errors="replace").partition("signerInfos:")[2]
    found = re.search(r"digestAlgorithm:\s+algorithm: (\S+)", signers)
    return found[1] if found else ""


def _run_openssl(*arguments: str) -> "subprocess.CompletedProcess[bytes]":
    program = shutil.which("openssl")
    if program is None:
        raise LookupError("openssl")
    return subprocess.run([program, *arguments], capture_output=True, timeout=_OPENSSL_TIMEOUT_S, check=False)


def read_permissions(file: SignedFile) -> Permissions:
    """Return the permissions in the first grant of a signed file.

    Raises:
        BadInput: the permissions are invalid; the text contains the file and, if found, the line.
    """
    grant = file.root().find("permissions/grant")
    if grant is None:
        raise BadInput("has no grant: expected permissions/grant of OMG DDS Security", file=file.path)
    fingerprint = re.search(rf"<!-- {FINGERPRINT} ([0-9a-f]{{64}}) -->", file.text)
    return Permissions(
        subject=_required_text(grant, "subject_name", file),
        not_before=_read_time(grant, "validity/not_before", file),
        not_after=_read_time(grant, "validity/not_after", file),
        fingerprint=fingerprint[1] if fingerprint else "",
        rules=tuple(_rules(grant)),
        allows_by_default=_required_text(grant, "default", file) != "DENY",
    )


def governance_faults(file: SignedFile, domain_id: int) -> Iterator[BadInput]:
    """Yield a fault for each entry of a governance that makes the policies of a domain ineffective.

    If no rule applies in the domain, this fault is the only one.
    """
    rules = [rule for rule in file.root().iter("domain_rule") if is_in_domains(rule.find("domains"), domain_id)]
    if not rules:
        line = file.line_of("<domains>")
        yield BadInput(f"domains: no rule for domain {domain_id}, in which the suite runs", file=file.path, line=line)
        return
    topic_keys = "enable_read_access_control", "enable_write_access_control"
    wanted = [("allow_unauthenticated_participants", _NO), ("enable_join_access_control", _YES)]
    wanted += [(f"topic_access_rules/topic_rule/{key}", _YES) for key in topic_keys]
    for key, allowed in wanted:
        for element in rules[0].findall(key):
            if (element.text or "").strip().lower() not in allowed:
                name = key.rpartition("/")[2]
                reason = f"{name} is {element.text}: expected {allowed[0]}, or the policies have no effect"
                yield BadInput(reason, file=file.path, line=file.line_of(f"<{name}>{element.text}"))


def is_in_domains(domains: ET.Element | None, domain_id: int) -> bool:
    """True if a domain is listed: by its id, or in a range."""
    if domains is None:
        return False
    if any((element.text or "").strip() == str(domain_id) for element in domains.findall("id")):
        return True
    for span in domains.findall("id_range"):
        low, high = span.findtext("min", "0").strip(), span.findtext("max", "232").strip()
        if low.isdigit() and high.isdigit() and int(low) <= domain_id <= int(high):
            return True
    return False


def _rules(grant: ET.Element) -> Iterator[_Rule]:
    for element in grant:
        if element.tag in ("allow_rule", "deny_rule"):
            topics = {action: tuple(_element_texts(element.findall(f"{action}/topics/topic"))) for action in _ACTIONS}
            yield _Rule(element.tag == "allow_rule", element.find("domains"), topics)


def _element_texts(elements: Iterable[ET.Element]) -> Iterator[str]:
    return ((element.text or "").strip() for element in elements)


def _required_text(grant: ET.Element, key: str, file: SignedFile) -> str:
    text = grant.findtext(key)
    if not text or not text.strip():
        raise BadInput(f"has no {key}: expected it in permissions/grant", file=file.path, line=file.line_of("<grant"))
    return text.strip()


def _read_time(grant: ET.Element, key: str, file: SignedFile) -> datetime.datetime:
    text = _required_text(grant, key, file)
    try:
        time = datetime.datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError as problem:
        reason = f"{key} is '{text}': expected a date as 2026-05-01T00:00:00"
        raise BadInput(reason, file=file.path, line=file.line_of(text)) from problem
    return time if time.tzinfo else time.replace(tzinfo=datetime.timezone.utc)
