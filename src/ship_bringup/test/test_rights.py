"""Rights in a suite: least privilege, as SROS2 policy and as permissions of DDS Security.

The structure of the XML is that of ``policy.xsd`` 0.2.0 and ``permissions.xsd`` of sros2.
"""

import datetime
import fnmatch
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from ship_bags.errors import BadInput
from ship_bringup.commands import policies
from ship_bringup.security.policy_xml import governance_text, permissions_text, policy_text, read_topics, written_topics
from ship_bringup.security.rights import device_of, load_companions, nmea_in_topics, suite_rights
from ship_bringup.suite.plan import check_nodes

PACKAGE = Path(__file__).parents[1]
ROOT = PACKAGE.parents[1]
EXAMPLES = ("two_sensors", "three_sensors", "theodolite", "nbp1406")
FIRST = datetime.datetime(2026, 5, 1, tzinfo=datetime.timezone.utc)
LAST = datetime.datetime(2027, 5, 1, tzinfo=datetime.timezone.utc)


def rights_of(name, **options):
    nodes, _ = check_nodes(ROOT / "examples" / f"{name}.yaml", "demo")
    return {each.enclave: each for each in suite_rights([node.adapter for node in nodes], "demo", **options)}


def may(rights, action, topic):
    """True if the permissions allow ``action`` on ``topic`` (DDS Security 1.1, 9.4.1.3), without the suite's reader."""
    grant = ET.fromstring(permissions_text(rights, 7, FIRST, LAST)).find("permissions/grant")
    assert grant.findtext("default") == "DENY"
    assert [rule.tag for rule in grant if rule.tag.endswith("_rule")] == ["allow_rule"]
    allowed = [element.text for element in grant.findall(f"allow_rule/{action}/topics/topic")]
    return any(fnmatch.fnmatchcase(topic, pattern) for pattern in allowed)


@pytest.mark.parametrize("example", EXAMPLES)
def test_only_the_own_node_publishes_attitude_and_pointing(example):
    every = rights_of(example)
    for topic, node in (("ship/attitude", "ship_attitude"), ("theodolite/pointing", "optical_axis")):
        publishers = {name for name, rights in every.items() if may(rights, "publish", f"rt/demo/{topic}")}
        assert publishers == {f"/demo/{node}"} & set(every)


@pytest.mark.parametrize("example", EXAMPLES)
def test_sensor_publishes_only_its_own_topics(example):
    every = rights_of(example)
    assert may(every["/demo/sensors/ins"], "publish", "rt/demo/ins/imu")
    for name, rights in every.items():
        if name.startswith("/demo/sensors/"):
            device = name.rpartition("/")[2]
            own = {device_of(topic.removeprefix("/demo/")) for topic in rights.publishes if topic.startswith("/demo/")}
            assert own == {device}
            assert rights.subscribes == {"/parameter_events"}
        assert may(rights, "publish", "rt/demo/ins/imu") == (name == "/demo/sensors/ins")


@pytest.mark.parametrize("locked", [False, True])
def test_only_param_sets_parameters_unless_locked(locked):
    every = rights_of("theodolite", is_locked=locked)
    for node in ("ship_attitude", "optical_axis", "alerts"):
        for service in ("set_parameters", "set_parameters_atomically"):
            topic = f"rq/demo/{node}/{service}Request"
            publishers = {name for name, rights in every.items() if may(rights, "publish", topic)}
            assert publishers == ({"/demo/param"} if service.endswith("atomically") and not locked else set())
        # The node keeps its permission to respond, without which ROS could not start the node.
        assert may(every[f"/demo/{node}"], "subscribe", f"rq/demo/{node}/set_parametersRequest")
    assert may(every["/demo/param"], "publish", "rq/demo/ship_attitude/get_parametersRequest")


def test_clock_and_truth_need_played_bags():
    for rights in rights_of("two_sensors").values():
        assert not any("clock" in topic or "truth" in topic for topic in written_topics(rights) | read_topics(rights))
    played = rights_of("two_sensors", is_played=True)
    assert [name for name, rights in played.items() if may(rights, "publish", "rt/clock")] == ["/demo/play"]
    assert may(played["/demo/ship_attitude"], "subscribe", "rt/clock")
    assert may(played["/demo/play"], "publish", "rt/demo/truth/attitude")


NMEA = """
/**/nmea_out: {ros__parameters: {sinks: {bridge: {kind: udp, address: 127.0.0.1, port: 10111, sentences: [HDT]}}}}
/**/nmea_in:
  ros__parameters:
    sources:
      seapath: {kind: udp, port: 10110, becomes: ins}
      s330: {kind: tcp, address: 127.0.0.1, port: 4001, becomes: reference}
"""


def test_rights_of_nmea_nodes(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text((ROOT / "examples" / "two_sensors.yaml").read_text() + NMEA)
    companions = load_companions(path, "demo")
    every = rights_of("two_sensors", companions=companions)
    out, into = every["/demo/nmea_out"], every["/demo/nmea_in"]
    assert out.subscribes == {"/demo/ship/attitude", "/demo/ship/alerts"}
    assert out.requests == {"/demo/alerts/acknowledge"}
    assert {topic for topic in out.publishes if topic.startswith("/demo/")} == set()
    assert not into.subscribes | into.requests
    given = {topic for topic in into.publishes if topic.startswith("/demo/")}
    assert given == {f"/demo/{topic}" for topic in ("ins/imu", "gnss/fix", "reference/s330/imu")}
    assert set(nmea_in_topics(companions)) == {"ins/imu", "gnss/fix", "reference/s330/imu"}
    # No other node may publish the topics of nmea_in; without nmea_in, a driver of the INS may.
    assert [name for name, rights in every.items() if "/demo/ins/imu" in rights.publishes] == ["/demo/nmea_in"]
    assert "/demo/sensors/ins" in rights_of("two_sensors")
    assert {"/demo/sensors/star_fore", "/demo/sensors/ins"} & set(every) == {"/demo/sensors/star_fore"}
    assert not {"/demo/nmea_out", "/demo/nmea_in"} & set(rights_of("two_sensors"))


def test_wrong_parameter_of_a_companion_is_one_line(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text(NMEA.replace("becomes: ins", "becomes: gold"))
    with pytest.raises(BadInput, match=rf"^{path}:6: parameter 'sources.seapath.becomes'"):
        load_companions(path, "demo")


def test_services_are_two_topics_one_each_way():
    alerts, page = (rights_of("two_sensors")[f"/demo/{name}"] for name in ("alerts", "monitor"))
    assert may(alerts, "subscribe", "rq/demo/alerts/acknowledgeRequest")
    assert may(alerts, "publish", "rr/demo/alerts/acknowledgeReply")
    assert may(page, "publish", "rq/demo/alerts/acknowledgeRequest")
    assert may(page, "subscribe", "rr/demo/alerts/acknowledgeReply")
    assert not may(page, "publish", "rr/demo/alerts/acknowledgeReply")


@pytest.mark.parametrize(
    ("topic", "device"),
    [("ins/imu", "ins"), ("star/fore/observations", "star_fore"), ("reference/seapath/imu", "reference_seapath"),
     ("beacon/a/baseline", "beacon_a"), ("met/pressure", "met"), ("theodolite/encoder", "theodolite")],
)  # fmt: skip
def test_device_of_topic(topic, device):
    assert device_of(topic) == device


def test_policy_has_the_structure_of_the_schema():
    root = ET.fromstring(policy_text(tuple(rights_of("theodolite").values())))
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    actions = {"topics": {"publish", "subscribe"}, "services": {"reply", "request"}}
    for enclave in root.findall("enclaves/enclave"):
        (profiles,) = enclave
        assert [element.tag for element in profiles] == ["profile", "metadata"]
        assert set(profiles[0].attrib) == {"ns", "node"}
        for group in profiles[0]:
            assert set(group.attrib) <= actions[group.tag]
            assert set(group.attrib.values()) == {"ALLOW"}
            assert {name.tag for name in group} == {group.tag[:-1]}
            assert all(name.text.startswith("/") for name in group)


def test_governance_requires_certificates():
    rule = ET.fromstring(governance_text(7)).find("domain_access_rules/domain_rule")
    assert rule.findtext("domains/id") == "7"
    assert rule.findtext("allow_unauthenticated_participants") == "false"
    assert rule.findtext("enable_join_access_control") == "true"
    topic = rule.find("topic_access_rules/topic_rule")
    assert topic.findtext("topic_expression") == "*"
    assert {topic.findtext(f"enable_{each}_access_control") for each in ("read", "write")} == {"true"}


def test_fingerprint_depends_on_all_declarations():
    one = rights_of("two_sensors")["/demo/ship_attitude"]
    assert one.fingerprint == rights_of("two_sensors")["/demo/ship_attitude"].fingerprint
    declared = [each.replace("sensor_msgs/msg/Imu", "sensor_msgs/msg/Imu2") for each in one.declarations]
    others = (
        {"publishes": one.publishes - {"/rosout"}},
        {"declarations": tuple(declared)},
        {"declarations": one.declarations[:-1]},
        {"serves": one.serves | {"/demo/ship_attitude/more"}},
    )
    found = {one.fingerprint, *(type(one)(**{**vars(one), **change}).fingerprint for change in others)}
    assert len(found) == 1 + len(others)


@pytest.mark.parametrize("example", EXAMPLES)
def test_shipped_policies_match_the_code(example, tmp_path, capsys):
    suite_file = ROOT / "examples" / f"{example}.yaml"
    assert policies.main([str(suite_file), "--out", str(tmp_path / "out")]) == 0
    made = (tmp_path / "out" / "policy.xml").read_bytes()
    path = PACKAGE / "security" / f"{example}.policy.xml"
    remedy = f"ros2 run ship_bringup policies {suite_file} --out OUT, then copy OUT/policy.xml to {path}"
    assert path.read_bytes() == made, remedy


def test_policies_are_reproducible_and_overwrite_nothing(tmp_path, capsys):
    command = [str(ROOT / "examples" / "theodolite.yaml"), "--namespace", "demo", "--locked", "--domain", "7"]
    command += ["--valid-from", "2026-05-01", "--valid-days", "365"]
    assert policies.main([*command, "--out", str(tmp_path / "one")]) == 0
    assert policies.main([*command, "--out", str(tmp_path / "two")]) == 0
    one, two = (
        {path.relative_to(tmp_path / name): path.read_bytes() for path in (tmp_path / name).rglob("*.xml")}
        for name in ("one", "two")
    )
    assert one == two
    assert Path("permissions/demo/sensors/star_fore/permissions.xml") in one
    text = one[Path("permissions/demo/ship_attitude/permissions.xml")].decode()
    assert "<not_before>2026-05-01T00:00:00</not_before>" in text
    assert "<not_after>2027-05-01T00:00:00</not_after>" in text
    assert policies.main([*command, "--out", str(tmp_path / "one")]) == 2
    assert "policy.xml" in capsys.readouterr().err
    assert policies.main([*command, "--out", str(tmp_path / "one"), "--force"]) == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(["--domain", "233"], "233 is not a domain of ROS"), (["--valid-from", "1.5.26"], "expected one as 2026-05-01"),
     (["--valid-days", "0"], "0 is not a number of days")],
)  # fmt: skip
def test_bad_arguments_are_one_line(arguments, expected, tmp_path, capsys):
    with pytest.raises(SystemExit) as left:
        policies.main([str(ROOT / "examples" / "two_sensors.yaml"), "--out", str(tmp_path / "out"), *arguments])
    assert left.value.code == 2
    assert expected in capsys.readouterr().err


def test_unknown_parameter_of_the_suite_file_is_one_line(tmp_path, capsys):
    path = tmp_path / "suite.yaml"
    path.write_text("/**/ship_attitude:\n  ros__parameters:\n    lagg_s: 2.0\n")
    assert policies.main([str(path), "--out", str(tmp_path / "out")]) == 2
    assert f"{path}:3: parameter 'lagg_s' is unknown" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
