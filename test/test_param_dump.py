"""The output of ``ros2 param dump`` of a node starts it again, with the same parameters of the same types."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.parameter import Parameter, parameter_value_to_python

from ship_bags.live.ros_process import prepare_dds
from ship_nmea.instruments.config import NmeaInConfig
from ship_nmea.instruments.nmea_in import NmeaIn
from ship_nmea.nmea_node import NmeaNode
from ship_nmea.out.config import NmeaOutConfig
from ship_nmea.out.nmea_out import NmeaOut
from ship_node.live.live_node import LiveNode
from ship_node.parameters.parameter_file import read_node_parameters
from ship_replay.offline.replay import ADAPTERS
from ship_testing.own_domain import own_domain  # noqa: F401 - a fixture

pytestmark = [pytest.mark.live, pytest.mark.usefixtures("own_domain")]

SUITE = """
/**/ship_attitude: {ros__parameters: {star_sensors: {fore: {azimuth_deg: 0.0, elevation_deg: 60.0}}}}
/**/star_attitude:
  ros__parameters:
    star_sensors:
      fore: {azimuth_deg: 0.0, elevation_deg: 60.0, camera: {focal_length_m: 0.1, pixel_pitch_m: 5.0e-6}}
/**/optical_axis: {ros__parameters: {telescope: {telescope_id: main, focal_length_m: 0.1}}}
/**/triangulation:
  ros__parameters:
    origin: {latitude_deg: 30.0, longitude_deg: 120.0, height_m: 9.0}
    stations:
      a: {latitude_deg: 30.0, longitude_deg: 120.0, height_m: 9.0}
      b: {latitude_deg: 30.001, longitude_deg: 120.0, height_m: 8.0}
/**/nmea_in: {ros__parameters: {sources: {gyro: {kind: udp, becomes: gyro, port: 10199}}}}
/**/nmea_out: {ros__parameters: {sinks: {bridge: {kind: udp, address: 127.0.0.1, port: 10198, sentences: [HDT]}}}}
"""
NODES = {adapter.node_name: partial(LiveNode, adapter) for adapter in ADAPTERS} | {
    "nmea_in": partial(NmeaNode, "nmea_in", NmeaInConfig, NmeaIn),
    "nmea_out": partial(NmeaNode, "nmea_out", NmeaOutConfig, NmeaOut),
}


def set_nested(group: dict[str, Any], name: str, value: Any) -> None:
    first, dot, rest = name.partition(".")
    if dot:
        set_nested(group.setdefault(first, {}), rest, value)
    else:
        group[first] = value


def dump(name: str, file: Path) -> tuple[str, dict[str, Parameter.Type]]:
    """Return the output of ``ros2 param dump`` of a node started with a file, and the type of each parameter."""
    context = Context()
    prepare_dds()
    rclpy.init(args=[name, "--ros-args", "--params-file", str(file)], context=context)
    try:
        node = NODES[name](context, (file,))
        parameters: dict[str, Any] = {}
        for parameter, kept in sorted(node.node._parameters.items()):
            value = parameter_value_to_python(kept.get_parameter_value())
            set_nested(parameters, parameter, list(value) if hasattr(value, "typecode") else value)
        text = yaml.dump({node.node.get_fully_qualified_name(): {"ros__parameters": parameters}})
        types = {parameter: kept.type_ for parameter, kept in node.node._parameters.items()}
        node.close()
    finally:
        context.try_shutdown()
    return text, types


@pytest.mark.parametrize("name", NODES)
def test_a_dump_starts_the_node_again(name: str, tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(SUITE)
    first, types = dump(name, tmp_path / "suite.yaml")
    (tmp_path / "dump.yaml").write_text(first)
    assert read_node_parameters(tmp_path / "dump.yaml", name).values
    assert dump(name, tmp_path / "dump.yaml") == (first, types)
    assert Parameter.Type.BYTE_ARRAY not in types.values()
    if "integrity.alert_limit_arcsec" in types:
        assert types["integrity.alert_limit_arcsec"] is Parameter.Type.DOUBLE_ARRAY
