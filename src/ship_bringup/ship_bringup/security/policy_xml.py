"""Policies as files: the policy of SROS2, and governance and permissions of OMG DDS Security 1.1.

The policy contains ROS names. Permissions contain the names of ROS 2 in DDS: ``rt/`` before a topic; ``rq/`` and
``Request``, or ``rr/`` and ``Reply``, around a service. Governance and permissions equal the files that ``ros2
security`` makes from the policy. Without ROS, governance and permissions are signed by hand.
"""

import datetime
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from ship_bringup.security.rights import Rights

POLICY_VERSION = "0.2.0"
FINGERPRINT = "fingerprint"
"""Name of :attr:`Rights.fingerprint` as an attribute of a policy's metadata and in a comment of permissions."""

DISCOVERY_TOPIC = "ros_discovery_info"
"""Topic by which participants of rmw_fastrtps exchange their nodes; every enclave needs it."""

_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_"
_ALLOW = "ALLOW"


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
    return _text(root)


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
    return _text(root)


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
    head, _, body = _text(root).partition("\n")
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


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
