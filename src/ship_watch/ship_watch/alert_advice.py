"""Advice for each kind of alert, one line for people; docs/explanation/alerts.md has the same table."""

import re

ADVICE = {
    "attitude.silent": "Check that the node ship_attitude runs, and its log; use the gyro meanwhile",
    "attitude.degraded": "Read the error budget; wait for stars; do not use what is lost",
    "pointing.silent": "Check that the node optical_axis runs, and its log",
    "pointing.degraded": "Send up the other drone; sight both lights",
    "stars.out": "Check what the star sensors share: network, clock, cover, GNSS fix",
    "ins.out": "Check the INS's own alarms; let it settle; by night the stars carry the attitude at their rate",
    "star.ID.out": "Clean the sensor and check its mounting; calibrate it again if it was moved",
    "star.ID.remounted": "Check its bolts; calibrate its installation before the next voyage",
    "reference.ID.out": "Check the reference system's own alarms; let it settle",
    "reference.ID.remounted": "Check its bolts; calibrate its installation before the next voyage",
    "encoder.out": "Check the mount's controller; home the axes",
    "lights.out": "Nothing while the drones are on deck; otherwise check lamps and identities",
    "baselines.out": "Check the radio link and the receivers' fix",
    "ship_attitude.out": "Check the alerts of the attitude and the load of the computer",
    "gnss.out": "Check antenna and receiver",
    "weather.out": "Check the weather station",
    "SOURCE.unreported": "Start that node again",
    "SOURCE.mended": "Give the drones their own names again",
    "SOURCE.rate": "Check the settings of the source and the network",
    "stars.old": "Nothing by day or under clouds: the accuracy decays as the error budget shows",
    "lights.old": "Sight the lights",
    "clock.ahead": "Set the clocks: NTP or PTP on the computer and the instrument",
    "NODE.box": "Free the disk; start the node again for another black box",
    "NODE.clock": "Check who publishes /clock",
    "NODE.stamps": "Set the clock, or use_sim_time for a bag",
    "NODE.name": "End one of the two nodes",
    "NODE.overload": "End what else runs on the computer; lower rates; play a bag more slowly",
    "NODE.recovered": "Read the log for what had failed; compare the alignment with the one before",
    "NODE.software": "Keep the black box and report it",
    "NODE.sink.ID": "Check cable, port and disk, see /diagnostics; displays there show nothing, or old values",
    "NODE.source.ID": "Check the instrument and its line; /diagnostics shows what comes instead",
    "disk.full": "Delete or move recordings",
}
"""Kind of an alert → what to do."""

_ENDINGS = {"unreported": "SOURCE", "mended": "SOURCE", "rate": "SOURCE"}
_OF_NODES = ("box", "clock", "stamps", "name", "overload", "recovered", "software")


def kind_of(alert_id: str) -> str:
    """Return the kind of an alert as :data:`ADVICE` names it: "star.ID.out" for "star.fore.out"."""
    if alert_id in ADVICE:
        return alert_id
    first, _, ending = alert_id.rpartition(".")
    if ending in _ENDINGS:
        return f"{_ENDINGS[ending]}.{ending}"
    if line := re.search(r"\.(sink|source)\.[^.]+$", alert_id):
        return f"NODE.{line[1]}.ID"
    device = first.partition(".")[0]
    if device in ("star", "reference"):
        return f"{device}.ID.{ending}"
    return f"NODE.{ending}" if ending in _OF_NODES else ""


def advice_for(alert_id: str) -> str:
    """Return what to do about an alert, one line; empty for an id that this suite does not use."""
    return ADVICE.get(kind_of(alert_id), "")
