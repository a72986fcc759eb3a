"""Ship logs to bags: numbers of a real log, a log made from a known motion, and lines that are no good.

The bursts quoted here are lines of R/V Nathaniel B. Palmer's log of 2014-08-01 from the public test data of
OpenRVDAS (MIT licence, https://github.com/OceanDataTools/openrvdas).
"""

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
import yaml

from ship_bags.commands.import_nmea import main
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.nmea.instrument_lines import datetime_ns
from ship_bags.stamps import ns_from_stamp
from ship_geometry.frames import (
    angles_from_rotation,
    device_vector_from_ros,
    rotation_from_angles,
    rotation_from_quaternion,
)
from ship_geometry.rotations import log_rotation
from ship_testing.ship_logs import GYR1, MWX1, SEAP, sentence

S330 = """\
2014-08-01T00:00:00.285000Z $INZDA,000000.17,01,08,2014,,*7E
2014-08-01T00:00:00.285000Z $INGGA,000000.16,2200.110899,S,01756.359432,W,1,12,0.7,-2.76,M,4.67,M,,*6C
2014-08-01T00:00:00.402000Z $INVTG,215.11,T,239.79,M,9.1,N,16.9,K,A*05
2014-08-01T00:00:00.522000Z $INRMC,000000.16,A,2200.110899,S,01756.359432,W,9.1,215.11,010814,24.7,W,A*3B
2014-08-01T00:00:00.522000Z $INHDT,218.26,T*1A
2014-08-01T00:00:00.522000Z $PSXN,20,1,0,0,0*3A
2014-08-01T00:00:00.522000Z $PSXN,22,0.03,-0.80*1F
2014-08-01T00:00:00.522000Z $PSXN,23,0.35,-1.74,218.26,0.58*13
"""
MIDNIGHT_NS = datetime_ns(datetime(2014, 8, 1, tzinfo=timezone.utc))


def line(receive_s, body):
    time = datetime(2014, 8, 1, tzinfo=timezone.utc) + timedelta(seconds=receive_s)
    return f"{time:%Y-%m-%dT%H:%M:%S.%f}Z {sentence(body)}\n"


def seapath(times_s, angles_deg, delay_s=0.3):
    """Return a log of bursts at given times with given roll, pitch, heading (rows, degrees), printed to 1e-9°."""
    text = ""
    for time_s, (roll, pitch, heading) in zip(times_s, angles_deg, strict=True):
        clock = datetime(2014, 8, 1) + timedelta(seconds=float(time_s))  # noqa: DTZ001 - only to print it
        text += line(time_s + delay_s - 0.1, f"GPZDA,{clock:%H%M%S.%f},01,08,2014,,")
        text += line(time_s + delay_s, f"PSXN,23,{roll:.9f},{pitch:.9f},{heading:.9f},0.0")
    return text


@pytest.fixture
def import_texts(tmp_path):
    """Import texts; return the messages by topic as (log time, message), metadata and report."""

    def run(*options, **texts):
        arguments = list(options)
        for name, text in texts.items():
            path = tmp_path / f"{name}.log"
            path.write_text(text)
            known = name in ("ins", "weather", "gyro")
            arguments += [f"--{name}", str(path)] if known else ["--reference", f"{name}={path}"]
        out = tmp_path / "out.mcap"
        assert main([*arguments, "--out", str(out)]) == 0
        found = {}
        with read_bag(out) as bag:
            for record in bag.records():
                found.setdefault(record.topic, []).append((record.log_time_ns, record.decode()))
            assert bag.problems == []
            return found, bag.metadata["import_nmea"], yaml.safe_load(bag.attachments["import_nmea.yaml"])

    return run


def angles_deg(message):
    """Heading, pitch, roll of an Imu, degrees."""
    q = message.orientation
    return np.rad2deg(angles_from_rotation(rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))))


def test_first_burst_by_the_instruments_time(import_texts):
    found, marks, _ = import_texts(ins=S330)
    ((log_time_ns, message),) = found["ins/imu"]
    # ZDA 00:00:00.17; PSXN,23 received at .522: roll 0.35, pitch -1.74, heading 218.26.
    assert ns_from_stamp(message.header.stamp) == MIDNIGHT_NS + 170_000_000
    assert log_time_ns == MIDNIGHT_NS + 522_000_000
    np.testing.assert_allclose(angles_deg(message), [218.26, -1.74, 0.35], atol=1e-9)
    assert message.header.frame_id == "ins"
    assert message.angular_velocity_covariance[0] == -1.0
    assert message.linear_acceleration_covariance[0] == -1.0
    assert not message.orientation_covariance.any()
    assert marks["time"] == "instrument"
    assert marks["resampled_hz"] == "no"


def test_first_burst_by_the_receive_time(import_texts):
    found, marks, _ = import_texts("--time", "receive", ins=S330)
    ((log_time_ns, message),) = found["ins/imu"]
    assert ns_from_stamp(message.header.stamp) == log_time_ns == MIDNIGHT_NS + 522_000_000
    assert marks["time"] == "receive"


def test_position(import_texts):
    found, _, _ = import_texts(ins=S330)
    ((log_time_ns, fix),) = found["gnss/fix"]
    assert ns_from_stamp(fix.header.stamp) == MIDNIGHT_NS + 160_000_000
    assert log_time_ns == MIDNIGHT_NS + 285_000_000
    # 22° 00.110899′ S, 17° 56.359432′ W, -2.76 m above a geoid 4.67 m above the ellipsoid.
    assert fix.latitude == pytest.approx(-(22 + 0.110899 / 60))
    assert fix.longitude == pytest.approx(-(17 + 56.359432 / 60))
    assert fix.altitude == pytest.approx(1.91)
    assert fix.status.status == 0
    assert fix.position_covariance[0] == pytest.approx((3.0 * 0.7) ** 2)


def test_position_without_the_geoid_has_no_altitude(import_texts):
    found, _, _ = import_texts(ins=SEAP)
    assert np.isnan(found["gnss/fix"][0][1].altitude)


def test_reference_weather_and_gyro(import_texts):
    found, marks, counts = import_texts(ins=SEAP, s330=S330, weather=MWX1, gyro=GYR1)
    ((_, reference),) = found["reference/s330/imu"]
    np.testing.assert_allclose(angles_deg(reference), [218.26, -1.74, 0.35], atol=1e-9)
    assert reference.header.frame_id == "s330"
    assert marks["reference.s330"] == "s330.log"
    ((_, gyro),) = found["reference/gyro/imu"]
    np.testing.assert_allclose(angles_deg(gyro), [218.53, 0.0, 0.0], atol=1e-9)
    assert ns_from_stamp(gyro.header.stamp) == MIDNIGHT_NS + 183_000_000
    assert gyro.orientation_covariance[0] == 1.0  # rad²: roll and pitch are not measured
    assert found["met/temperature"][0][1].temperature == 19.07
    assert found["met/humidity"][0][1].relative_humidity == pytest.approx(0.639)
    assert found["met/pressure"][0][1].fluid_pressure == pytest.approx(102_332.8)
    assert found["met/pressure"][0][0] == MIDNIGHT_NS + 274_000_000
    assert counts["files"]["weather.log"] == {
        "lines": 2,
        "used": {"MET": 1},
        "rejected": {},
        "not_of_interest": {"SUS": 1},
    }
    assert counts["files"]["s330.log"]["not_of_interest"] == {"INRMC": 1, "INVTG": 1, "PSXN22": 1}


def test_log_times_do_not_go_back(import_texts):
    found, _, _ = import_texts("--resample", "20", ins=rolling_log()[0], s330=S330)
    times = [time for messages in found.values() for time, _ in messages]
    assert times
    assert all(np.all(np.diff([time for time, _ in messages]) >= 0) for messages in found.values())


AMPLITUDE_DEG, PERIOD_S = 4.0, 11.0


def roll_deg(time_s):
    return AMPLITUDE_DEG * np.sin(2 * np.pi * np.asarray(time_s) / PERIOD_S)


def rolling_log(seconds=60, missing=()):
    """Return a log of a rolling ship, heading 300°, bow up 2°, at 1 Hz."""
    times_s = np.array([time_s for time_s in np.arange(seconds) + 0.7 if round(time_s - 0.7) not in missing])
    angles = np.column_stack([roll_deg(times_s), np.full(len(times_s), 2.0), np.full(len(times_s), 300.0)])
    return seapath(times_s, angles), times_s


def test_resampled_by_a_spline(import_texts):
    text, times_s = rolling_log()
    found, marks, _ = import_texts("--resample", "50", ins=text)
    assert marks["resampled_hz"] == "50"
    stamps_ns = np.array([ns_from_stamp(message.header.stamp) for _, message in found["ins/imu"]])
    # The grid of 50 Hz from 0.7 s to 59.7 s, exact in nanoseconds.
    np.testing.assert_array_equal(stamps_ns - MIDNIGHT_NS, np.arange(35, 2986) * 20_000_000)
    time_s = (stamps_ns - MIDNIGHT_NS) * 1e-9
    inside = (time_s > times_s[0] + 4) & (time_s < times_s[-1] - 4)
    angles = np.array([angles_deg(message) for _, message in found["ins/imu"]])[inside]
    np.testing.assert_allclose(angles[:, 1], 2.0, atol=2e-3)
    # Straight interpolation errs by a w² h²/8 = 4° (2 pi/11)²/8 = 0.163°; a cubic spline by a w⁴ 5/384 h⁴ = 0.0055°.
    error = np.abs(angles[:, 2] - roll_deg(time_s[inside]))
    assert error.max() < 0.008
    assert found["ins/imu"][0][1].angular_velocity_covariance[0] == 0.0


def test_angular_velocity_is_that_of_the_motion(import_texts):
    """The angular velocities (forward, left, up; deck frame) equal differences of the attitudes in the bag."""
    found, _, _ = import_texts("--resample", "50", ins=rolling_log()[0])
    messages = [message for _, message in found["ins/imu"]]
    quaternions = np.array([[m.orientation.x, m.orientation.y, m.orientation.z, m.orientation.w] for m in messages])
    rotations = rotation_from_quaternion(quaternions)
    differenced = log_rotation(np.swapaxes(rotations[:-2], 1, 2) @ rotations[2:]) / 0.04
    flu = np.array([[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in messages])
    np.testing.assert_allclose(device_vector_from_ros(flu)[1:-1], differenced, atol=2e-4)
    # Starboard goes down while the roll grows: the rate about the bow is positive then.
    rate = np.deg2rad(AMPLITUDE_DEG) * 2 * np.pi / PERIOD_S
    assert flu[:, 0].max() == pytest.approx(rate, rel=0.02)


def test_log_time_of_resampled_messages_is_the_stamp_and_the_usual_delay(import_texts):
    found, _, _ = import_texts("--resample", "10", ins=rolling_log()[0])
    delays = {time_ns - ns_from_stamp(message.header.stamp) for time_ns, message in found["ins/imu"]}
    assert delays == {300_000_000}


@pytest.mark.parametrize(("missing", "bridged"), [((20, 21), True), ((20, 21, 22), False)])
def test_gaps_of_more_than_three_seconds_stay_gaps(import_texts, missing, bridged):
    found, _, _ = import_texts("--resample", "10", ins=rolling_log(missing=missing)[0])
    stamps = np.array([ns_from_stamp(message.header.stamp) for _, message in found["ins/imu"]])
    in_gap = np.sum((stamps > MIDNIGHT_NS + 19_700_000_000) & (stamps < MIDNIGHT_NS + 23_700_000_000))
    # Three seconds from the sample at 19.7 s to that at 22.7 s are bridged, four to 23.7 s are not.
    assert (in_gap > 20) == bridged
    assert bridged or in_gap == 0


def test_references_are_never_resampled(import_texts):
    text, times_s = rolling_log()
    found, _, _ = import_texts("--resample", "10", ins=text, b=text)
    assert len(found["reference/b/imu"]) == len(times_s)


def test_pashr_with_the_day_from_the_receive_time(import_texts):
    """The sentence is received just after midnight and is valid just before midnight."""
    text = line(0.1, "PASHR,235959.950,224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,1,0")
    found, _, _ = import_texts(ins=text)
    ((log_time_ns, message),) = found["ins/imu"]
    assert ns_from_stamp(message.header.stamp) == MIDNIGHT_NS - 50_000_000
    assert log_time_ns == MIDNIGHT_NS + 100_000_000
    np.testing.assert_allclose(angles_deg(message), [224.19, 0.83, -1.26], atol=1e-9)


@pytest.mark.parametrize("time", ["235959", "235959.9", "235959.95", "235959.9500", "235959.950000"])
def test_pashr_with_a_time_of_any_precision(import_texts, time):
    """pynmea2 itself accepts only two or three decimals."""
    found, _, _ = import_texts(ins=line(0.1, f"PASHR,{time},224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,1,0"))
    ((_, message),) = found["ins/imu"]
    fraction = f"0.{time.partition('.')[2] or 0}"
    assert ns_from_stamp(message.header.stamp) == MIDNIGHT_NS - 10**9 + round(float(fraction) * 10**9)
    np.testing.assert_allclose(angles_deg(message), [224.19, 0.83, -1.26], atol=1e-9)


def test_pashr_of_a_system_that_is_not_aligned_is_no_attitude(import_texts, capsys):
    """NovAtel and Trimble set both last fields to 0 if not aligned.

    Other makers set one of them to 0 in a valid attitude, e.g. in an RT300.
    """
    good = line(0.1, "PASHR,000000.050,224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,1,0")
    bad = line(0.2, "PASHR,000000.150,024.19,T,-11.26,+10.83,+00.10,9.900,9.900,9.900,0,0")
    void = line(0.3, "PASHR,000000.250,224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,,")
    found, _, _ = import_texts(ins=good + bad + void)
    assert len(found["ins/imu"]) == 2
    assert "PASHR: no aiding, and the IMU's status is 0" in capsys.readouterr().out


def weeks_ago(text, weeks):
    """Return a log of 2014-08-01 whose ZDA state a day that many weeks earlier."""
    day = datetime(2014, 8, 1, tzinfo=timezone.utc) - timedelta(weeks=weeks)
    lines = [line.partition(" ")[::2] for line in text.splitlines()]
    bodies = [(time, body[1:-3].replace("01,08,2014", f"{day:%d,%m,%Y}")) for time, body in lines]
    return "".join(f"{time} {sentence(body)}\n" for time, body in bodies)


@pytest.mark.parametrize("rollovers", [1, 2, -1])
def test_gps_week_rollovers_are_corrected_and_reported(import_texts, capsys, rollovers):
    """A receiver that lost 1024 weeks: 2014 becomes 1994, as on real ships."""
    found, _, counts = import_texts(ins=weeks_ago(S330, 1024 * rollovers), second=weeks_ago(S330, 1024 * rollovers))
    expected, _, _ = import_texts("--force", ins=S330, second=S330)
    for topic in ("ins/imu", "reference/second/imu", "gnss/fix"):
        stamps = [[ns_from_stamp(message.header.stamp) for _, message in run[topic]] for run in (found, expected)]
        assert stamps[0] == stamps[1]
    correction = f"instrument time corrected by {1024 * rollovers:+d} weeks (GPS week rollover)"
    assert counts["files"]["ins.log"]["put_right"] == {correction: 1}
    assert f"{correction} 1" in capsys.readouterr().out


def test_a_single_wrong_time_rejects_only_its_attitude(import_texts, capsys):
    wrong = weeks_ago(S330, 3).replace("2014-08-01T00:00:00", "2014-08-01T00:00:01")
    zda = "$INZDA,000000.17,01,08,2014,,*7E"
    later = S330.replace("00:00:00", "00:00:09").replace(zda, sentence("INZDA,000009.17,01,08,2014,,"))
    found, _, counts = import_texts(ins=wrong + later)
    assert len(found["ins/imu"]) == 1
    assert counts["files"]["ins.log"]["rejected"] == {"instrument time": 1}
    assert "instrument time: '2014-07-11T00:00:00Z is 21.0 days before the receive time'" in capsys.readouterr().out


def test_a_time_of_day_far_from_the_receive_time_is_rejected(import_texts):
    """Local time instead of UTC: an offset of one hour, in PASHR and GGA."""
    good = "PASHR,000000.050,224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,1,0"
    gga = "GPGGA,{},2200.112071,S,01756.360200,W,1,10,0.9,1.04,M,,M,,"
    text = line(0.1, good) + line(0.2, gga.format("000000.10")) + line(0.3, gga.format("010000.20"))
    text += line(1.1, good.replace("000000.050", "010001.050"))
    found, _, counts = import_texts(ins=text)
    assert [len(found[topic]) for topic in ("ins/imu", "gnss/fix")] == [1, 1]
    assert counts["files"]["ins.log"]["rejected"] == {"instrument time": 2}
    found, _, counts = import_texts("--time", "receive", "--force", ins=text)
    assert [len(found[topic]) for topic in ("ins/imu", "gnss/fix")] == [2, 2]


@pytest.mark.parametrize("late", [1, -1], ids=["before", "after"])
def test_a_minute_off_the_receive_time_may_be_a_delay_and_more_is_wrong(import_texts, late):
    body = "PASHR,12{}.000,224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,1,0"
    for off_s, rejected in ((59, {}), (61, {"instrument time": 1})):
        text = line(12 * 3600 + 1800, body.format("3000"))
        text += line(12 * 3600 + 1860 + late * off_s, body.format("3100"))
        found, _, counts = import_texts("--force", ins=text)
        assert len(found["ins/imu"]) == 2 - len(rejected)
        assert counts["files"]["ins.log"]["rejected"] == rejected


def test_a_log_without_attitude_gives_only_the_fix(import_texts, capsys):
    positions = "".join(line for line in S330.splitlines(keepends=True) if "GGA" in line)
    found, _, _ = import_texts("--resample", "20", ins=positions + GYR1)
    assert set(found) == {"gnss/fix"}
    assert "the log contains no attitude: only gnss/fix is written" in capsys.readouterr().out


def test_unusable_lines_are_counted_and_shown(import_texts, capsys):
    bad = [
        "no time at all",
        "2014-08-01T00:00:01.000000Z $PSXN",
        "2014-08-01T00:00:01.000000Z ???",
        "2014-08-01T00:00:01.000000Z $PSXN,23,0.35,-1.74,218.27,0.58*13",  # a digit changed: checksum
        "2014-08-01T00:00:01.000000Z " + sentence("PSXN,23,a,b,c,0.58"),
        "2014-08-01T00:00:02.000000Z " + sentence("PSXN,23,0.35,-1.74,218.27,0.58"),  # no ZDA opened its burst
        "\x00\xff binary",
    ]
    found, _, counts = import_texts(ins=S330 + "\n".join(bad) + "\n")
    assert len(found["ins/imu"]) == 1
    assert counts["files"]["ins.log"]["rejected"] == {
        "attitude without ZDA": 1,
        "checksum failed": 1,
        "half line or no checksum": 1,
        "no receive time": 2,
        "unparsed": 2,
    }
    assert counts["files"]["ins.log"]["lines"] == 15
    printed = capsys.readouterr().out
    assert "ins.log:12: checksum failed: '$PSXN,23,0.35" in printed
    assert "ins.log:9: no receive time: 'no time at all'" in printed


def test_attitudes_marked_invalid_by_the_seapath(import_texts):
    invalid = S330.replace("$PSXN,20,1,0,0,0*3A", sentence("PSXN,20,1,0,0,2"))
    later = invalid.replace("2014-08-01T00:00:00", "2014-08-01T00:00:05").replace(
        "$INZDA,000000.17,01,08,2014,,*7E", sentence("INZDA,000005.17,01,08,2014,,")
    )
    found, _, counts = import_texts(ins=S330 + later)
    assert len(found["ins/imu"]) == 1
    assert counts["files"]["ins.log"]["rejected"] == {"invalid by PSXN,20": 1}


def test_the_same_logs_give_the_same_bytes(tmp_path):
    log = tmp_path / "ins.log"
    log.write_text(rolling_log()[0])
    for name in ("a", "b"):
        assert main(["--ins", str(log), "--resample", "10", "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_suite_configuration_is_attached(tmp_path):
    log, suite = tmp_path / "ins.log", tmp_path / "nbp.yaml"
    log.write_text(S330)
    suite.write_text("ship_attitude: {ros__parameters: {}}\n")
    assert main(["--ins", str(log), "--config", str(suite), "--out", str(tmp_path / "a.mcap")]) == 0
    with read_bag(tmp_path / "a.mcap") as bag:
        assert bag.attachments["suite.yaml"] == suite.read_bytes()


@pytest.mark.parametrize(
    ("options", "text", "complaint"),
    [
        ([], "", "ins.log: the file is empty"),
        ([], "nothing\n", "ins.log: no line could be read"),
        ([], GYR1, "ins.log: no usable attitude: expected PSXN,23 with ZDA, PASHR, PRDID, PTNTHPR or PSAT,HPR"),
        (["--resample", "0"], S330, "--resample 0: expected a rate above 0"),
        (["--resample", "10"], S330, "no two attitudes within 3 s"),
        (["--reference", "b"], S330, "--reference b: expected NAME=FILE"),
        (["--reference", "b=none.log"], S330, "none.log: cannot be read: No such file"),
        (["--weather", "{ins}"], S330, "ins.log: no MET, MDA or XDR in 8 lines"),
        (["--gyro", "{ins}x"], S330, "ins.logx: cannot be read"),
        (["--time", "gps"], S330, "invalid choice: 'gps'"),
        (
            [],
            weeks_ago(S330, 3),
            "ins.log:1: instrument time: '2014-07-11T00:00:00Z is 21.0 days before the receive time'; --time receive",
        ),
    ],
)
def test_bad_input_is_one_line_and_two(tmp_path, capsys, options, text, complaint):
    log = tmp_path / "ins.log"
    log.write_text(text)
    options = [option.format(ins=log) for option in options]
    try:
        code = main(["--ins", str(log), *options, "--out", str(tmp_path / "out.mcap")])
    except SystemExit as caught:
        code = caught.code
    assert code == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert complaint in error
    assert not (tmp_path / "out.mcap").exists()


def test_heading_passes_through_north(import_texts):
    """The spline takes the short way from 359° to 1°."""
    times_s = np.arange(20) + 0.5
    headings = (355.0 + times_s) % 360.0
    angles = np.column_stack([np.zeros(20), np.zeros(20), headings])
    found, _, _ = import_texts("--resample", "10", ins=seapath(times_s, angles))
    for _, message in found["ins/imu"]:
        time_s = (ns_from_stamp(message.header.stamp) - MIDNIGHT_NS) * 1e-9
        expected = rotation_from_angles(np.deg2rad(355.0 + time_s), 0.0, 0.0)
        q = message.orientation
        actual = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
        assert np.linalg.norm(log_rotation(expected.T @ actual)) < 1e-8
        # Turning clockwise is a negative rate about the up axis.
        assert message.angular_velocity.z == pytest.approx(-np.deg2rad(1.0), rel=1e-6)


def test_weather_by_mda_and_xdr(import_texts):
    """MDA: the example in pynmea2's source, of an Airmar PB150; XDR: as in the manual of Vaisala's WXT520."""
    mda = "WIMDA,30.2269,I,1.0236,B,17.7,C,,,43.3,,5.0,C,131.5,T,128.6,M,0.8,N,0.4,M"
    xdr = "WIXDR,C,23.3,C,0,H,50.1,P,0,P,1009.5,H,0"
    found, _, _ = import_texts(
        ins=S330, weather=line(0.0, mda) + line(1.0, xdr) + line(2.0, "WIXDR,P,1.0095,B,0,U,24,V,1")
    )
    assert [message.temperature for _, message in found["met/temperature"]] == [17.7, 23.3]
    humidity = [message.relative_humidity for _, message in found["met/humidity"]]
    assert humidity == pytest.approx([0.433, 0.501])
    pressure_pa = [message.fluid_pressure for _, message in found["met/pressure"]]
    assert pressure_pa == pytest.approx([102_360.0, 100_950.0, 100_950.0])


def test_several_transducers_of_a_kind_are_not_used(import_texts, capsys):
    """Airmar's weather stations send two wind chills as C; from the first such line on neither is used."""
    chills = "YXXDR,C,28.7,C,WCHR,C,28.6,C,WCHT,P,1.0149,B,STNP"
    found, _, counts = import_texts(ins=S330, weather=line(0.0, chills) + line(1.0, "YXXDR,C,20.0,C,WCHR"))
    assert "met/temperature" not in found
    assert len(found["met/pressure"]) == 1
    assert counts["files"]["weather.log"]["rejected"] == {"several transducers": 2}
    assert "temperature of WCHR, WCHT: name the transducer of the air in transducers" in capsys.readouterr().out


def test_heading_with_its_status(import_texts):
    """THS (IEC 61162-1): mode A is used, V and others are not, nor HDT of the same instrument."""
    gyro = line(0.0, "HETHS,218.53,A") + line(1.0, "HETHS,218.60,V") + line(1.5, "HETHS,,V") + line(2.0, "HEHDT,10.0,T")
    found, _, counts = import_texts(ins=S330, gyro=gyro)
    ((_, message),) = found["reference/gyro/imu"]
    np.testing.assert_allclose(angles_deg(message), [218.53, 0.0, 0.0], atol=1e-9)
    assert counts["files"]["gyro.log"]["rejected"] == {"THS not in mode A": 2}


@pytest.mark.parametrize("text", ["nan", "NaN", "inf", "sNaN"])
def test_an_invalid_number_is_no_heading(import_texts, text):
    found, _, counts = import_texts(ins=S330, gyro=GYR1 + line(1.0, f"HEHDT,{text},T"))
    assert len(found["reference/gyro/imu"]) == 1
    assert counts["files"]["gyro.log"]["rejected"] == {"unparsed": 1}
