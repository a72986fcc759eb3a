"""check_config: all errors, each with its line, and contradictions to a bag."""

import sys

import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_replay.commands.check_config import main
from ship_testing.hand_made_bags import START_NS, imu, vector

GOOD = """\
ship_attitude:
  ros__parameters:
    ins:
      frame_id: ins
    references:
      b:
        frame_id: b
"""


@pytest.fixture
def check(tmp_path, capsys):
    """Run the command on texts; return exit code, findings, and other output on stderr."""

    def run(text, bag=None, *options):
        config = tmp_path / "suite.yaml"
        config.write_text(text)
        code = main([str(config), *([str(bag)] if bag else []), *options])
        captured = capsys.readouterr()
        reported, found = (text.replace(f"{tmp_path}/", "").splitlines() for text in (captured.err, captured.out))
        errors = [line for line in reported if line.startswith("error: ")]
        return code, errors + found, [line for line in reported if line not in errors]

    return run


def write_bag(path, ins_frame="ins", b_frame="b", prefix="", topics=("ins/imu", "reference/b/imu")):
    frames = {"ins/imu": ins_frame}
    with BagWriter(path) as bag:
        for number in range(3):
            stamp_ns = START_NS + number
            for topic in topics:
                bag.write(prefix + topic, imu(stamp_ns, frames.get(topic, b_frame)), stamp_ns)
    return path


def test_a_configuration_that_fits(check, tmp_path):
    assert check(GOOD, write_bag(tmp_path / "a.mcap")) == (0, ["suite.yaml: good for a.mcap"], [])
    assert check(GOOD) == (0, ["suite.yaml: good"], [])


def test_all_wrong_parameters_are_named_with_their_lines(check):
    text = """\
ship_attitude:
  ros__parameters:
    ins:
      convention: enu
      tilt_sigma_arcsec: -1.0
    lagg_s: 1.0
    star_sensors:
      fore:
        azimuth_deg: 400.0
        elevation_deg: high
      aft: {roll_deg: 1.0}
    coasting_after_s: 1
"""
    code, lines, errors = check(text)
    assert code == 2
    starts = {line.split(" must ")[0].split(" is ")[0].split(" (")[0] for line in lines}
    assert starts == {
        "error: suite.yaml:4: parameter 'ins.convention' = 'enu'",
        "error: suite.yaml:5: parameter 'ins.tilt_sigma_arcsec' = -1.0 arcsec",
        "error: suite.yaml:6: parameter 'lagg_s'",
        "error: suite.yaml:9: parameter 'star_sensors.fore.azimuth_deg' = 400.0 deg",
        "error: suite.yaml:10: parameter 'star_sensors.fore.elevation_deg'",
        "error: suite.yaml:11: parameter 'star_sensors.aft.azimuth_deg'",
        "error: suite.yaml:11: parameter 'star_sensors.aft.elevation_deg'",
    }
    assert len(lines) == 7
    assert errors == ["check_config: suite.yaml: errors: 7, warnings: 0"]


def test_each_error_is_reported_once(check):
    _, lines, errors = check(GOOD.replace("    ins:", "    lagg_s: 1.0\n    ins:"))
    assert "".join(lines + errors).count("lagg_s") == 1
    remedy = "expected one of lag_s, max_age_s, smoothing_lag_s or 18 others; did you mean 'lag_s'?"
    assert lines[0] == f"error: suite.yaml:3: parameter 'lagg_s' is unknown: {remedy}"


def test_wrong_frame_id(check, tmp_path):
    code, (line,), _ = check(GOOD, write_bag(tmp_path / "a.mcap", b_frame="c"))
    assert code == 2
    expected = "parameter 'references.b.frame_id' = 'b', but topic 'reference/b/imu' in a.mcap carries frame_id 'c'"
    assert line == f"error: suite.yaml:7: {expected}"


def test_required_topic_missing(check, tmp_path):
    code, lines, _ = check(GOOD, write_bag(tmp_path / "a.mcap", topics=("reference/b/imu",)))
    assert code == 2
    assert lines == ["error: suite.yaml:4: topic 'ins/imu' is not in a.mcap: needed by ship_attitude"]


def test_sensor_without_a_topic_is_a_warning(check, tmp_path):
    code, lines, _ = check(GOOD, write_bag(tmp_path / "a.mcap", topics=("ins/imu",)))
    assert code == 0
    warning = "warning: suite.yaml:7: topic 'reference/b/imu' is not in a.mcap: optional for ship_attitude"
    assert lines == [warning, "suite.yaml: good for a.mcap"]


def test_topic_without_a_configuration_is_a_warning(check, tmp_path):
    bag = write_bag(tmp_path / "a.mcap", topics=("ins/imu", "reference/b/imu", "reference/gyro/imu"))
    code, lines, _ = check(GOOD, bag)
    assert code == 0
    assert "warning: a.mcap: topic 'reference/gyro/imu' has no references.gyro in the configuration: not used" in lines


def test_wrong_type(check, tmp_path):
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.write("ins/imu", vector(), START_NS)
        bag.write("reference/b/imu", imu(START_NS, "b"), START_NS)
    code, (line,), _ = check(GOOD, tmp_path / "a.mcap")
    assert code == 2
    expected = "topic 'ins/imu' in a.mcap is geometry_msgs/msg/Vector3: expected sensor_msgs/msg/Imu"
    assert line == f"error: suite.yaml:4: {expected}"


def test_a_bag_in_a_namespace(check, tmp_path):
    bag = write_bag(tmp_path / "a.mcap", prefix="/palmer/")
    text = GOOD.replace("ship_attitude:", "/**/ship_attitude:")
    code, lines, _ = check(text, bag)
    assert code == 2
    expected = "topic 'ins/imu' is not in a.mcap: needed by ship_attitude (found in namespace 'palmer')"
    assert lines[0] == f"error: suite.yaml:4: {expected}"
    assert check(text, bag, "--namespace", "palmer")[0] == 0


def test_names_are_checked_as_by_a_node(check, tmp_path):
    """A section without a wildcard fits no node in a namespace; a section of a namespace fits no node outside it."""
    bag = write_bag(tmp_path / "a.mcap", prefix="/palmer/")
    code, lines, _ = check(GOOD, bag, "--namespace", "palmer")
    assert code == 2
    advice = "name it '/**/ship_attitude' to fit in every namespace, or run the node in that of the section"
    misfit = f"error: suite.yaml:1: section '/ship_attitude' does not fit node '/palmer/ship_attitude': {advice}"
    assert lines[0] == f"{misfit} (give it no namespace)"
    code, lines, _ = check(GOOD.replace("ship_attitude:", "/palmer/ship_attitude:"))
    misfit = f"error: suite.yaml:1: section '/palmer/ship_attitude' does not fit node '/ship_attitude': {advice}"
    assert (code, lines) == (2, [f"{misfit} (-r __ns:=/palmer, of a tool --namespace palmer)"])
    everywhere = "/**:\n  ros__parameters: {lag_s: 1.0}\n"
    in_palmer = everywhere + GOOD.replace("ship_attitude:", "/palmer/ship_attitude:")
    assert check(in_palmer, bag, "--namespace", "/palmer/")[:2] == (0, ["suite.yaml: good for a.mcap"])
    # As reported by a node: the first section fits, so this is not an error.
    code, lines, _ = check(in_palmer)
    assert code == 0
    assert lines[0].startswith("warning: suite.yaml: section '/palmer/ship_attitude' fits no node of this suite")


def test_the_ins_alone_is_a_warning(check):
    code, lines, _ = check("ship_attitude:\n  ros__parameters: {}\n")
    assert code == 0
    assert "no star_sensors, no references and no ship_baseline are configured" in lines[0]


def test_problems_of_the_bag_are_warnings(check, tmp_path):
    bag = write_bag(tmp_path / "a.mcap")
    bag.write_bytes(bag.read_bytes()[:-20])
    code, lines, _ = check(GOOD, bag)
    assert code == 0
    assert any(line.startswith("warning: a.mcap: its summary is missing or damaged; 6 messages") for line in lines)


STARS = """\
ship_attitude:
  ros__parameters:
    star_sensors:
      fore: {azimuth_deg: 0.0, elevation_deg: 45.0, input: solution}
star_attitude:
  ros__parameters:
    star_sensors:
      fore:
        azimuth_deg: 0.0
        elevation_deg: 45.0
        frame_id: star_fore
        camera: {focal_length_m: 0.05, pixel_pitch_m: 5.5e-6}
"""


def star_bag(path, frame_id="star_fore", sensor="fore"):
    factory = RosbagsFactory()
    with BagWriter(path) as bag:
        header = make_header(factory, START_NS, frame_id)
        fields = {"header": header, "sensor_id": sensor, "exposure_s": 0.1, "stars": []}
        message = factory.make("ship_msgs/msg/StarObservationArray", **fields)
        bag.write(f"star/{sensor}/observations", message, START_NS)
        bag.write("ins/imu", imu(START_NS), START_NS)
    return path


def test_each_node_of_the_suite_is_checked(check, tmp_path):
    code, lines, _ = check(STARS, star_bag(tmp_path / "a.mcap", frame_id="camera"))
    assert code == 2
    assert lines[0] == "error: suite.yaml: topic 'gnss/fix' is not in a.mcap: needed by ship_attitude and star_attitude"
    expected = "parameter 'star_sensors.fore.frame_id' = 'star_fore', but topic 'star/fore/observations' in a.mcap"
    assert lines[1] == f"error: suite.yaml:11: {expected} carries frame_id 'camera'"
    # The outputs of star_attitude need not be in the bag.
    assert not any("star/fore/solution" in line for line in lines)
    wrong = STARS.replace("pixel_pitch_m: 5.5e-6", "pixel_pitch_mm: 5.5e-3")
    assert "error: suite.yaml:12: parameter 'star_sensors.fore.camera.pixel_pitch_mm' is unknown" in check(wrong)[1][0]


def test_a_missing_camera_is_reported_without_a_bag(check):
    text = STARS.partition("star_attitude:")[0].replace("solution", "observations")
    code, lines, _ = check(text)
    assert code == 2
    assert lines[0].startswith("error: suite.yaml:4: parameters 'star_sensors.fore.camera.focal_length_m'")


def test_a_topic_missing_for_two_nodes_is_reported_once_with_both(check, tmp_path):
    camera = "camera: {focal_length_m: 0.05, pixel_pitch_m: 5.5e-6}"
    text = STARS.replace("input: solution}", f"input: observations, {camera}}}")
    _, lines, _ = check(text, star_bag(tmp_path / "a.mcap"))
    reported = [line for line in lines if "gnss/fix" in line]
    assert reported == [
        "error: suite.yaml: topic 'gnss/fix' is not in a.mcap: needed by ship_attitude and star_attitude"
    ]


def test_a_camera_out_of_range_is_reported_once(check):
    """The value out of range leaves no camera, but there is no second error about a missing camera."""
    text = STARS.partition("star_attitude:")[0].replace(
        "input: solution}", "input: observations, camera: {focal_length_m: 50.0, pixel_pitch_m: 5.5e-6}}"
    )
    code, lines, _ = check(text)
    assert code == 2
    (line,) = lines
    assert line.startswith("error: suite.yaml:4: parameter 'star_sensors.fore.camera.focal_length_m' = 50.0 m is")


def test_a_sensor_that_is_bolted_elsewhere_for_another_node_is_a_warning(check):
    code, lines, _ = check(STARS.replace("        azimuth_deg: 0.0", "        azimuth_deg: 90.0"))
    assert code == 0
    text = "parameter 'star_sensors.fore.azimuth_deg' is 90.0 for star_attitude, but 0.0 for ship_attitude"
    assert lines[0] == f"warning: suite.yaml:9: {text}"


def test_a_sky_that_is_another_one_for_another_node_is_a_warning(check):
    """ship_attitude uses its own sky to separate errors that a solution of star_attitude shares with other sensors."""
    text = STARS + "    sky: {fix_sigma_m: 100.0, magnitude_limit: 6.0}\n"
    code, lines, _ = check(text)
    assert code == 0
    expected = "parameter 'sky.fix_sigma_m' is 100.0 for star_attitude, but 5.0 for ship_attitude"
    assert lines[:-1] == [f"warning: suite.yaml:13: {expected}"]
    # The sky of ship_attitude does not matter if ship_attitude does not use it.
    assert not any("sky" in line for line in check(text.replace("input: solution", "input: horizon_attitude"))[1])


MOUNT = """\
optical_axis:
  ros__parameters:
    telescope: {telescope_id: main, focal_length_m: 0.1}
    sky: {fix_sigma_m: 100.0}
"""
NIGHT = """\
    telescopes:
      night:
        azimuth_deg: 0.0
        elevation_deg: 0.0
        roll_deg: 0.0
        camera: {focal_length_m: 0.1, pixel_pitch_m: 6.5e-6}
"""


def test_stars_on_the_mount_are_in_the_sky_of_those_on_the_deck(check):
    code, lines, _ = check(STARS + MOUNT + NIGHT)
    assert code == 0
    text = "parameter 'sky.fix_sigma_m' is 100.0 for optical_axis, but 5.0 for"
    assert {f"warning: suite.yaml:16: {text} {name}" for name in ("ship_attitude", "star_attitude")} < set(lines)
    # Without a camera on the mount, its sky does not matter.
    assert not any("sky" in line for line in check(STARS + MOUNT)[1])


ESTIMATORS = "'/**/ship_attitude', '/**/star_attitude', '/**/optical_axis', '/**/triangulation'"
NODES = f"expected one of {ESTIMATORS}, '/**/nmea_in', '/**/nmea_out'"
NODES += " or '/**'"


def test_a_misspelt_node_is_an_error(check):
    """The node itself refuses a file with a misspelt section."""
    misfit = "section '/star_atitude' does not fit node '/star_attitude': name it '/**/star_attitude' to fit in every"
    code, lines, _ = check(STARS.replace("star_attitude:", "star_atitude:"))
    assert code == 2
    assert len(lines) == 1
    assert lines[0].startswith(f"error: suite.yaml:5: {misfit}")
    code, lines, _ = check(GOOD.replace("ship_attitude:", "star_atitude:"))
    assert code == 2
    assert lines[0].startswith(f"error: suite.yaml:1: {misfit}")


def test_a_section_of_a_node_that_is_not_ours_is_a_warning(check):
    code, lines, _ = check(GOOD + "radar:\n  ros__parameters: {gain: 1.0}\n")
    warning = f"warning: suite.yaml: section '/radar' fits no node of this suite: {NODES}"
    assert (code, lines) == (0, [warning, "suite.yaml: good"])
    code, lines, (error,) = check("radar:\n  ros__parameters: {gain: 1.0}\n")
    assert (code, lines) == (2, [])
    assert error.endswith(f"suite.yaml: no section for a node of this suite: {NODES}, found '/radar'")


def test_unused_observations_are_a_warning(check, tmp_path):
    _, lines, _ = check(STARS, star_bag(tmp_path / "a.mcap", sensor="aft"))
    expected = "topic 'star/aft/observations' has no star_sensors.aft in the configuration: not used"
    assert f"warning: a.mcap: {expected}" in lines


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "suite.yaml: empty"),
        ("monitor: {ros__parameters: {}}\n", "no section for a node of this suite"),
        ("ship_attitude: [\n", "not YAML"),
    ],
)
def test_no_parameter_file_is_one_line_and_two(check, text, complaint):
    code, lines, errors = check(text)
    assert code == 2
    assert lines == []
    assert len(errors) == 1
    assert complaint in errors[0]


@pytest.mark.parametrize("id_", ["fore mast", "fore-mast", "1", "före", "fore/mast"])
def test_an_id_that_is_no_topic_name_is_an_error(check, id_):
    """Without this check a node with a sensor of this id would end with a traceback: invalid topic name."""
    text = STARS.replace("      fore:", f"      '{id_}':")
    code, lines, _ = check(text)
    assert code == 2
    expected = (
        f"error: suite.yaml:4: parameter 'star_sensors.{id_}': '{id_}' cannot be an id: expected letters, digits and"
    )
    assert lines[0].startswith(expected)
    assert "Traceback" not in "".join(lines)


NMEA = """\
/**/nmea_out:
  ros__parameters:
    sinks:
      bridge: {kind: udp, address: 192.168.1.255, port: 10110}
/**/nmea_in:
  ros__parameters:
    sources:
      gyro: {kind: udp, port: 10111, becomes: gyro}
"""


def test_other_nodes_may_have_sections(check, tmp_path):
    assert check(GOOD + NMEA) == (0, ["suite.yaml: good"], [])
    assert check(GOOD + NMEA, write_bag(tmp_path / "a.mcap"))[0] == 0


def test_they_may_stand_alone_in_it(check, tmp_path):
    assert check(NMEA) == (0, ["suite.yaml: good"], [])
    assert check(NMEA, None, "--namespace", "aurora") == (0, ["suite.yaml: good"], [])
    code, (line,), _ = check(NMEA.replace("port: 10111", "port: 0"))
    assert (code, line[:50]) == (2, "error: suite.yaml:8: parameter 'sources.gyro.port'")
    code, (warning, _), _ = check(NMEA, write_bag(tmp_path / "a.mcap"))
    expected = "warning: suite.yaml: no section for an estimator: the bag is not checked"
    assert (code, warning) == (0, expected)


def nmea(sink, source, out_section="/**/nmea_out", in_section="/**/nmea_in"):
    """Sections of both NMEA nodes with one sink and one source, in lines 8 to 15."""
    sections = ((out_section, "sinks", "s", sink), (in_section, "sources", "g", f"{source}, becomes: gyro"))
    return "".join(f"{node}:\n  ros__parameters:\n    {group}:\n      {id_}: {{{text}}}\n"
                   for node, group, id_, text in sections)  # fmt: skip


TTY = "kind: serial, device: /dev/ttyUSB0"
UDP = "kind: udp, address: 10.0.0.1, port: 1, listen_port: 10110"


@pytest.mark.parametrize(
    ("sink", "source", "error"),
    [
        (TTY, TTY, "device' = '/dev/ttyUSB0' of /nmea_out: 'sources.g.device' of /nmea_in, line 15, has path /dev/tty"),
        (UDP, "kind: udp, port: 10110", "listen_port' = 10110 of /nmea_out: 'sources.g.port' of /nmea_in, line 15"),
        (UDP, "kind: udp, port: 10111", ""),
        ("kind: udp, address: 127.0.0.1, port: 10110", "kind: udp, port: 10110", ""),
        ("kind: tcp_server, port: 10110", "kind: tcp, address: 127.0.0.1, port: 10110", ""),
        ("kind: tcp_server, port: 10110", "kind: udp, port: 10110", ""),
    ],
)  # fmt: skip
def test_a_resource_of_both_nmea_nodes_is_an_error(check, sink, source, error):
    code, (line,), _ = check(GOOD + nmea(sink, source))
    assert code == (2 if error else 0)
    assert line.startswith(f"error: suite.yaml:11: parameter 'sinks.s.{error}" if error else "suite.yaml: good")


def test_the_same_place_of_another_namespace_is_another_machines(check):
    text = GOOD.replace("ship_attitude:", "/**/ship_attitude:") + nmea(TTY, TTY, "/a/nmea_out", "/b/nmea_in")
    text += nmea(TTY, TTY, "/b/nmea_out", "/a/nmea_in").replace("USB0", "USB1")
    code, lines, _ = check(text, None, "--namespace", "a")
    assert code == 0, lines


def test_a_resource_of_two_sinks_is_reported_once(check):
    files = "      log: {kind: file, path: a}\n      too: {kind: file, path: ./a}\n"
    text = GOOD + NMEA.replace("/**/nmea_in", f"{files}/**/nmea_in")
    code, lines, _ = check(text)
    expected = "parameter 'sinks.too.path' = 'a': 'sinks.log.path' has path a already: expected a path of its own"
    assert (code, lines) == (2, [f"error: suite.yaml:13: {expected}"])


def test_their_parameters_are_checked_too_all_of_them(check):
    text = NMEA.replace("port: 10110", "prt: 10110, rate_hz: 0.0").replace("becomes: gyro", "becomes: compass")
    code, found, _ = check(GOOD + text)
    assert code == 2
    assert sum("suite.yaml:11: parameter 'sinks.bridge." in line for line in found) >= 2
    assert any("suite.yaml:15: parameter 'sources.gyro.becomes' = 'compass' must be one of" in line for line in found)


def test_a_section_of_nearly_their_name_is_refused(check):
    code, found, _ = check(GOOD + NMEA.replace("/nmea_out", "/nmea_outs"))
    assert code == 2
    assert any("suite.yaml:8: section '/**/nmea_outs' does not fit node '/nmea_out'" in line for line in found)


def test_a_package_that_is_not_installed_is_reported_as_unchecked(check, monkeypatch):
    monkeypatch.setitem(sys.modules, "ship_nmea.out.config", None)
    code, found, _ = check(GOOD + NMEA)
    assert code == 0
    assert any("section 'nmea_out' is not checked: package ship_nmea is not installed" in line for line in found)
