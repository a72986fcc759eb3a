"""Definitions that a live node writes into a bag, compared with the built-in types."""

import pytest

from ship_bags.live.installed_types import installed_definition
from ship_bags.message_store import message_store, ship_message_folder, store_with_definitions, type_hash

TYPES = [f"ship_msgs/msg/{path.stem}" for path in sorted(ship_message_folder().glob("*.msg"))]
TYPES += ["sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"]
TYPES += ["diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/String"]


@pytest.mark.parametrize("type_name", TYPES)
def test_fields_and_hash_are_the_same(type_name: str) -> None:
    found = installed_definition(type_name)
    assert found.hash == type_hash(type_name)
    types = store_with_definitions({type_name: found.text})
    assert types.differences == {}
    assert types.store is message_store()
