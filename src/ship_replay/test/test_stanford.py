"""Errors against protection levels: counts worked out by hand, over bags made by hand; the figure and its texts."""

import json
import math

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import make_header
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_replay.commands.stanford import main
from ship_replay.evaluation.stanford import Epochs, Region, read_epochs
from ship_replay.evaluation.stanford_figure import stanford_figure
from ship_testing.hand_made_bags import FACTORY, START_NS, ship_attitude
from ship_watch.orientations import POINTING, SHIP_ATTITUDE

TENTH_NS = 100_000_000
QUANTITIES = ("heading", "pitch", "roll")
NOMINAL, MISLEADING, HAZARDOUS, UNAVAILABLE = Region


def integrity(stamp_ns, levels_arcsec, limits_arcsec=(math.nan,) * 3, state=3, quantities=QUANTITIES):
    return FACTORY.make(
        "ship_msgs/msg/Integrity",
        header=make_header(FACTORY, stamp_ns, "deck"),
        quantities=list(quantities),
        protection_level=np.array(levels_arcsec) * ARCSEC,
        alert_limit=np.array(limits_arcsec) * ARCSEC,
        p_hmi_per_h=1e-5,
        state=state,
        hypotheses=[],
        statistic=np.empty(0),
        threshold=np.empty(0),
        excluded=[],
        excluded_for_s=np.empty(0),
        dominant="",
    )


def write_run(path, epochs, levels, start_ns=START_NS):
    """Write attitudes a tenth of a second apart, and levels by the number of the epoch before which they are published.

    Args:
        path: path of the bag.
        epochs: errors of heading, pitch and roll (arcsec) and the status of each.
        levels: number of an epoch → message made by :func:`integrity` without its stamp.
        start_ns: stamp of the first epoch.
    """
    with BagWriter(path) as bag:
        for number, (errors, status) in enumerate(epochs):
            stamp_ns = start_ns + number * TENTH_NS
            if number in levels:
                bag.write("ship/integrity", levels[number](stamp_ns), stamp_ns)
            heading, pitch, roll = (error * ARCSEC for error in errors)
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            attitude = ship_attitude(stamp_ns, heading % (2 * np.pi), pitch, roll, status=status)
            bag.write("ship/attitude", attitude, stamp_ns)
    return path


@pytest.fixture(name="run")
def _run(tmp_path):
    """Ten epochs: levels of 10, 20, 30″ from the second on; 50, 20, 30″ from the eighth on; none at the last."""
    epochs = [
        ((0.0, 0.0, 0.0), Status.VALID),  # before any level
        ((5.0, -19.0, 29.0), Status.VALID),
        ((-11.0, 19.0, 29.0), Status.VALID),  # heading above its level
        ((9.0, 45.0, 0.0), Status.VALID),  # pitch above its level and the limit
        ((9.0, 45.0, 0.0), Status.DEGRADED),  # reported by the status
        ((math.nan, math.nan, math.nan), Status.INVALID),
        ((0.0, 0.0, 0.0), Status.COASTING),
        ((45.0, 0.0, 31.0), Status.VALID),  # the level of heading is above the limit; roll above its level
        ((0.0, 0.0, 0.0), Status.VALID),
        ((60.0, 60.0, 60.0), Status.VALID),  # no level any more
    ]
    limits = (40.0, 40.0, 40.0)
    levels = {
        1: lambda stamp_ns: integrity(stamp_ns, (10.0, 20.0, 30.0), limits, state=0),
        7: lambda stamp_ns: integrity(stamp_ns, (50.0, 20.0, 30.0), limits, state=1),
        9: lambda stamp_ns: integrity(stamp_ns, (50.0, 20.0, 30.0), limits, state=2),
    }
    return write_run(tmp_path / "run.mcap", epochs, levels)


def test_each_epoch_falls_into_the_region_worked_out_by_hand(run):
    (found,) = read_epochs([run])
    n, m, h, u = NOMINAL, MISLEADING, HAZARDOUS, UNAVAILABLE
    expected = [
        [u, u, u], [n, n, n], [m, n, n], [n, h, n], [u, u, u], [u, u, u], [n, n, n], [u, n, m], [u, n, n], [u, u, u],
    ]  # fmt: skip
    assert found.regions().tolist() == expected
    assert found.counts() == {
        "heading": {NOMINAL: 3, MISLEADING: 1, HAZARDOUS: 0, UNAVAILABLE: 6},
        "pitch": {NOMINAL: 5, MISLEADING: 0, HAZARDOUS: 1, UNAVAILABLE: 4},
        "roll": {NOMINAL: 5, MISLEADING: 1, HAZARDOUS: 0, UNAVAILABLE: 4},
    }
    values = found.statistics()
    assert values["epochs"] == 10
    assert values["pitch.availability"] == pytest.approx(0.6)
    assert values["pitch.worst_error_over_level"] == pytest.approx(45.0 / 20.0)
    assert values["roll.median_level_arcsec"] == pytest.approx(30.0)


def test_limits_of_the_command_line_take_the_place_of_those_in_the_bag(run):
    (found,) = read_epochs([run], limits_arcsec={"fused": (60.0, 15.0, 60.0)})
    counts = found.counts()
    assert counts["heading"] == {NOMINAL: 5, MISLEADING: 1, HAZARDOUS: 0, UNAVAILABLE: 4}
    assert counts["pitch"] == {NOMINAL: 0, MISLEADING: 0, HAZARDOUS: 0, UNAVAILABLE: 10}
    assert counts["roll"] == {NOMINAL: 5, MISLEADING: 1, HAZARDOUS: 0, UNAVAILABLE: 4}


def test_several_bags_come_together_and_between_the_truths_the_truth_is_interpolated(run, tmp_path):
    path = tmp_path / "fast.mcap"
    with BagWriter(path) as bag:
        bag.write("ship/integrity", integrity(START_NS, (10.0, 20.0, 30.0)), START_NS)
        for number in range(21):  # outputs ten times as often as the truth
            stamp_ns = START_NS + number * TENTH_NS // 10
            if number % 10 == 0:
                bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            bag.write("ship/attitude", ship_attitude(stamp_ns, pitch=2.0 * ARCSEC), stamp_ns)
    (alone,), (together,) = read_epochs([path]), read_epochs([run, path])
    assert alone.counts()["pitch"] == {NOMINAL: 21, MISLEADING: 0, HAZARDOUS: 0, UNAVAILABLE: 0}
    np.testing.assert_allclose(alone.error_arcsec[:, 1], 2.0, atol=1e-6)
    assert together.statistics()["epochs"] == 31


def pointing(stamp_ns, azimuth, elevation):
    unknown = dict.fromkeys(("telescope_azimuth", "telescope_elevation", "telescope_rotation"), math.nan)
    return FACTORY.make(
        "ship_msgs/msg/OpticalAxisPointing",
        header=make_header(FACTORY, stamp_ns, "main"),
        azimuth=azimuth % (2.0 * np.pi),
        elevation=elevation,
        image_rotation=0.0,
        covariance=np.zeros(9),
        rotation_covariance=np.zeros(9),
        mode=0,
        status=0,
        light_count=2,
        **unknown,
    )


def test_azimuth_counts_on_the_sky_at_stamps_of_the_truth(tmp_path):
    """At 60 degrees of elevation 18 arcseconds of azimuth are 9 on the sky: within a level of 10."""
    path, elevation = tmp_path / "p.mcap", np.deg2rad(60.0)
    with BagWriter(path) as bag:
        levels = integrity(START_NS, (10.0, 5.0, 20.0), quantities=POINTING.channels)
        bag.write("theodolite/integrity", levels, START_NS)
        for number in range(6):
            stamp_ns = START_NS + number * TENTH_NS
            if number % 2 == 0:
                bag.write("truth/pointing", pointing(stamp_ns, 0.0, elevation), stamp_ns)
            bag.write("theodolite/pointing", pointing(stamp_ns, 18.0 * ARCSEC, elevation + 6.0 * ARCSEC), stamp_ns)
    (found,) = read_epochs([path])
    assert found.orientation is POINTING
    assert found.counts() == {
        "azimuth_cos_elevation": {NOMINAL: 3, MISLEADING: 0, HAZARDOUS: 0, UNAVAILABLE: 0},
        "elevation": {NOMINAL: 0, MISLEADING: 3, HAZARDOUS: 0, UNAVAILABLE: 0},
        "image_rotation": {NOMINAL: 3, MISLEADING: 0, HAZARDOUS: 0, UNAVAILABLE: 0},
    }


def test_a_quantity_without_a_level_is_unavailable(tmp_path):
    levels = {0: lambda stamp_ns: integrity(stamp_ns, (10.0,), (math.nan,), quantities=("heading",))}
    (found,) = read_epochs([write_run(tmp_path / "a.mcap", [((0.0, 0.0, 0.0), Status.VALID)], levels)])
    assert [counts[UNAVAILABLE] for counts in found.counts().values()] == [0, 1, 1]


def test_a_valid_output_that_is_not_a_number_misleads():
    nothing = np.full((1, 3), math.nan)
    found = Epochs(SHIP_ATTITUDE, nothing, np.full((1, 3), 10.0), np.full((1, 3), math.inf), np.array([True]))
    assert NOMINAL not in found.regions()
    assert UNAVAILABLE not in found.regions()


def test_the_command_prints_writes_and_draws_and_fails_where_an_epoch_misled(run, tmp_path, capsys):
    figure, values = tmp_path / "s.png", tmp_path / "s.json"
    assert main([str(run), "--figure", str(figure), "--json", str(values)]) == 1
    printed = capsys.readouterr().out
    for words in ("hazardously", "unavailable", "heading", "40.00 %", "2.25"):
        assert words in printed
    counts = json.loads(values.read_text())
    assert counts["fused.heading.misleading"] == 1
    assert counts["fused.pitch.hazardously_misleading"] == 1
    assert counts["fused.roll.unavailable"] == 4
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_the_command_succeeds_where_nothing_misled(tmp_path):
    levels = {0: lambda stamp_ns: integrity(stamp_ns, (10.0, 20.0, 30.0))}
    path = write_run(tmp_path / "good.mcap", [((1.0, 2.0, 3.0), Status.VALID)] * 5, levels)
    assert main([str(path)]) == 0


@pytest.mark.parametrize("limits", [["0", "30", "30"], ["30", "-1", "30"], ["30", "nan", "30"], ["30", "inf", "30"]])
def test_alert_limits_of_nothing_are_refused(run, limits, capsys):
    assert main([str(run), "--alert-limit", *limits]) == 2
    assert "--alert-limit: alert limits must be above 0" in capsys.readouterr().err


def test_a_bag_without_levels_is_refused_by_the_topics_that_it_lacks(tmp_path):
    path = write_run(tmp_path / "a.mcap", [((0.0, 0.0, 0.0), Status.VALID)], {})
    with pytest.raises(BadInput, match="ship/integrity"):
        read_epochs([path])


def drawn_words(epochs):
    figure = stanford_figure([epochs], "t")
    words = [[text.get_text().replace("\n", " ") for text in axes.texts] for axes in figure.axes if axes.texts]
    plt.close(figure)
    return words


def many(limit, orientation=SHIP_ATTITUDE):
    """A thousand epochs with levels of 20″: 990 with errors of 3″, 10 of 50″."""
    error = np.full((1000, 3), 3.0)
    error[:10] = 50.0
    level, limits = np.full((1000, 3), 20.0), np.full((1000, 3), limit)
    return Epochs(orientation, error, level, limits, np.ones(1000, dtype=bool))


def test_the_figure_names_the_regions_with_their_counts():
    for words in drawn_words(many(30.0)):
        assert words == ["nominal 990", "unavailable 0", "hazardously misleading 10", "misleading 0"]
    for words in drawn_words(many(math.inf, POINTING)):
        assert words == ["nominal 990", "unavailable 0, not drawn", "misleading 10"]


def test_region_names_do_not_overlap():
    for limit in (30.0, math.inf):
        figure = stanford_figure([many(limit)], "t")
        figure.canvas.draw()
        for axes in figure.axes:
            boxes = [text.get_bbox_patch().get_window_extent() for text in axes.texts]
            for number, box in enumerate(boxes):
                assert not any(box.overlaps(other) for other in boxes[number + 1 :])
        plt.close(figure)


def test_changing_limits_are_an_error_and_missing_levels_are_shown():
    mixed = many(30.0)
    mixed.limit_arcsec[500:] = 40.0
    with pytest.raises(BadInput, match="30 and 40 arcsec: set a common one"):
        stanford_figure([mixed], "t")
    plt.close("all")
    nothing = many(30.0)
    nothing.level_arcsec[:] = math.nan
    assert drawn_words(nothing) == [["no epoch with a protection level"]] * 3
