"""Plan of a suite file with NMEA nodes: role of each program, a warning, and errors reported before the start."""

from pathlib import Path

import pytest

from ship_bags.errors import BadInput
from ship_bringup.suite.plan import SuiteOptions, make_plan
from ship_bringup.suite.supervisor import Role

ROOT = Path(__file__).parents[3]
DEMO = ROOT / "bags" / "demo.mcap"
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


@pytest.fixture
def suite(tmp_path):
    """A suite file that fits the demo, with sections for both NMEA nodes."""
    path = tmp_path / "suite.yaml"
    path.write_text((ROOT / "examples" / "two_sensors.yaml").read_text(encoding="utf-8") + NMEA)
    return path


def roles(programs):
    return {program.name: program.role for program in programs}


def test_roles_of_nmea_nodes(suite):
    programs, _ = make_plan(suite, SuiteOptions(namespace="aurora", monitor=True))
    assert roles(programs) == {
        "ship_attitude": Role.NODE, "nmea_in": Role.FEEDER, "nmea_out": Role.WATCHER, "monitor": Role.WATCHER,
        "alerts": Role.WATCHER,
    }  # fmt: skip
    (command,) = [program.command for program in programs if program.name == "nmea_out"]
    at = command.index("--params-file")
    assert command[at + 1 : at + 4] == (str(suite.resolve()), "-r", "__ns:=/aurora")


def test_bag_excludes_nmea_in_and_warns_of_nmea_out(suite):
    programs, warnings = make_plan(suite, SuiteOptions(bag=DEMO))
    assert roles(programs) == {"ship_attitude": Role.NODE, "nmea_out": Role.WATCHER, "play": Role.PLAYER}
    (command,) = [program.command for program in programs if program.name == "nmea_out"]
    assert "use_sim_time:=true" in command
    assert any("only as THS, with mode S (simulator)" in warning for warning in warnings)


def test_bad_nmea_parameter_is_reported_before_the_start(suite):
    suite.write_text(suite.read_text().replace("port: 10110", "prt: 10110"))
    line = suite.read_text().splitlines().index(next(s for s in suite.read_text().splitlines() if "prt" in s)) + 1
    with pytest.raises(BadInput, match=rf"suite.yaml:{line}: parameter 'sinks.bridge.prt' is unknown: .* 'port'\?"):
        make_plan(suite, SuiteOptions())


def test_shared_port_is_reported_before_the_start(suite):
    suite.write_text(suite.read_text().replace("port: 10110}", "port: 10110, listen_port: 10111}"))
    with pytest.raises(BadInput, match=r"suite.yaml:\d+: .*'sinks.bridge.listen_port' = 10111 .*'sources.gyro.port'"):
        make_plan(suite, SuiteOptions())


def test_suite_of_nmea_nodes_only(tmp_path):
    """Without estimators, for example on a second computer, the NMEA nodes have the role NODE."""
    path = tmp_path / "suite.yaml"
    path.write_text(NMEA)
    programs, _ = make_plan(path, SuiteOptions(namespace="aurora"))
    assert roles(programs) == {"nmea_in": Role.NODE, "nmea_out": Role.NODE}
    with pytest.raises(BadInput, match=r"suite.yaml: .*demo.mcap cannot be played: .* no section for an estimator"):
        make_plan(path, SuiteOptions(bag=DEMO))
