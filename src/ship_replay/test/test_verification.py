"""replay --verify on an ordinary bag that holds inputs and outputs of one run."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import message_store
from ship_replay.commands.replay import main
from ship_replay.offline.replay import replay as replay_bag

DEMO = Path(__file__).parents[3] / "bags" / "demo.mcap"
LENGTH_NS = 5_000_000_000
ATTITUDE = "ship/attitude"


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Return inputs of five seconds, the outputs of their replay, and the suite configuration."""
    folder = tmp_path_factory.mktemp("parts")
    with read_bag(DEMO) as bag, BagWriter(folder / "in.mcap") as writer:
        # For a ship in whatever namespace.
        suite = re.sub(rb"(?m)^ship_attitude:", b"/**/ship_attitude:", bag.attachments[SUITE_ATTACHMENT])
        writer.add_attachment(SUITE_ATTACHMENT, suite)
        inputs = [r for r in bag.records() if r.log_time_ns < bag.start_ns + LENGTH_NS and "truth" not in r.topic]
        for r in inputs:
            writer.write_raw(r.topic, r.type_name, r.data, r.log_time_ns)
    replay_bag(folder / "in.mcap", folder / "out.mcap", (ShipAttitudeAdapter,))
    with read_bag(folder / "out.mcap") as bag:
        return inputs, list(bag.records()), suite


def join_parts(path, parts, namespace="", change=lambda records: records):
    """Return the bag that a recorder of all topics would have written."""
    inputs, outputs, suite = parts
    with BagWriter(path) as writer:
        writer.add_attachment(SUITE_ATTACHMENT, suite)
        for r in [*inputs, *change(list(outputs))]:
            writer.write_raw(f"{namespace}{r.topic}", r.type_name, r.data, r.log_time_ns)
    return path


def verify(capsys, path, *options):
    code = main([str(path), "--verify", *options])
    return code, *capsys.readouterr()


@pytest.mark.parametrize(("namespace", "options"), [("", ()), ("/", ()), ("/ship_1/", ("--namespace", "ship_1"))])
def test_outputs_that_are_the_same_are_equal(parts, tmp_path, capsys, namespace, options):
    code, out, _ = verify(capsys, join_parts(tmp_path / "b.mcap", parts, namespace), *options)
    assert code == 0, out
    count = sum(1 for r in parts[1] if r.topic == ATTITUDE)
    assert count > 400
    assert f"{ATTITUDE} {count}" in out


def test_the_first_changed_field_is_named_with_both_values(parts, tmp_path, capsys):
    def change(outputs):
        numbers = [i for i, r in enumerate(outputs) if r.topic == ATTITUDE]
        for number in numbers[100:102]:
            message = outputs[number].decode()
            message.rotation_covariance = np.where(np.arange(9) == 4, 7.0, message.rotation_covariance)
            data = bytes(message_store().serialize_cdr(message, message.__msgtype__))
            outputs[number] = replace(outputs[number], data=data)
        return outputs

    originals = [r.decode() for r in parts[1] if r.topic == ATTITUDE]
    stamp = originals[100].header.stamp
    code, out, _ = verify(capsys, join_parts(tmp_path / "b.mcap", parts, change=change))
    assert code == 1
    value = float(originals[100].rotation_covariance[4])
    expected = f"({stamp.sec}{stamp.nanosec:09d} ns), field rotation_covariance[4]: recorded 7.0, replayed {value!r}"
    assert expected in out


def with_changed_innovations(outputs, change):
    """Return the outputs with the first ten innovations changed."""
    changed = list(outputs)
    for number in [i for i, r in enumerate(outputs) if r.topic == "ship/innovation"][:10]:
        message = outputs[number].decode()
        change(message)
        data = bytes(message_store().serialize_cdr(message, message.__msgtype__))
        changed[number] = replace(outputs[number], data=data)
    return changed


def rename_components(message):
    message.components = [f"earlier {name}" for name in message.components]


def test_texts_that_differ_are_counted_and_no_difference(parts, tmp_path, capsys):
    change = partial(with_changed_innovations, change=rename_components)
    path = join_parts(tmp_path / "b.mcap", parts, change=change)
    code, out, _ = verify(capsys, path)
    assert code == 0, out
    assert "other texts: ship/innovation 10; the first: ship/innovation, stamp 2014-" in out
    assert "field components[0]: recorded 'earlier " in out
    assert re.search(r"verified: the numbers of \d+ outputs are equal to the last bit", out)


def test_another_name_is_a_difference(parts, tmp_path, capsys):
    def change_source(message):
        message.source = f"{message.source}2"

    path = join_parts(tmp_path / "b.mcap", parts, change=partial(with_changed_innovations, change=change_source))
    code, out, _ = verify(capsys, path)
    assert code == 1
    assert re.search(r"first difference: ship/innovation, stamp .*, field source: recorded", out)


def test_a_number_that_differs_next_to_a_text_is_the_difference(parts, tmp_path, capsys):
    def change_both(message):
        rename_components(message)
        message.nis = np.nextafter(message.nis, 1e9)

    change = partial(with_changed_innovations, change=change_both)
    path = join_parts(tmp_path / "b.mcap", parts, change=change)
    code, out, _ = verify(capsys, path)
    assert code == 1
    assert re.search(r"first difference: ship/innovation, stamp .*, field nis: recorded", out)


def test_what_is_missing_at_the_end_is_a_difference(parts, tmp_path, capsys):
    def change(outputs):
        del outputs[max(i for i, r in enumerate(outputs) if r.topic == ATTITUDE)]
        return outputs

    code, out, _ = verify(capsys, join_parts(tmp_path / "b.mcap", parts, change=change))
    assert code == 1
    assert f"first difference: {ATTITUDE}, stamp" in out
    assert "recorded nothing, replayed a message" in out


def test_a_bag_without_outputs_is_refused(parts, tmp_path, capsys):
    code, _, err = verify(capsys, join_parts(tmp_path / "b.mcap", parts, change=lambda outputs: []))
    assert code == 2
    assert "no outputs of ship_attitude in this bag: there is nothing to verify" in err
