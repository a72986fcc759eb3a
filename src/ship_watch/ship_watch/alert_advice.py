"""Advice for each kind of alert, one line for people; docs/explanation/alerts.md has the same table."""

import re

ADVICE = {
    "attitude.silent": "Check that the node ship_attitude runs, and its log; use the gyro meanwhile",
    "attitude.degraded": "Read the error budget; wait for stars; do not use lost angles",
    "pointing.silent": "Check that the node optical_axis runs, and its log",
    "pointing.degraded": "Send up the other drone; sight both lights",
    "stars.out": "Check what the star sensors share: network, clock, cover, GNSS fix",
    "ins.out": "Check the INS's own alarms; let the INS settle; by night the attitude continues by the stars alone",
    "star.ID.out": "Clean the sensor and check its mounting; calibrate its installation if it was moved",
    "star.ID.remounted": "Check the bolts of its mounting; calibrate its installation before the next voyage",
    "reference.ID.out": "Check the reference system's own alarms; let the system settle",
    "reference.ID.remounted": "Check the bolts of its mounting; calibrate its installation before the next voyage",
    "encoder.out": "Check the mount's controller; home the axes",
    "lights.out": "No action while the drones are on deck; otherwise check lamps and identities",
    "baselines.out": "Check the radio link and the receivers' fix",
    "ship_attitude.out": "Check the alerts of the attitude and the load of the computer",
    "gnss.out": "Check antenna and receiver",
    "weather.out": "Check the weather station",
    "SOURCE.unreported": "Restart the node",
    "SOURCE.mended": "Correct the identities of the drones",
    "SOURCE.rate": "Check the settings of the source and the network",
    "stars.old": "No action by day or under clouds: the accuracy decays as the error budget shows",
    "lights.old": "Sight the lights",
    "clock.ahead": "Set the clocks: NTP or PTP on the computer and the instrument",
    "NODE.box": "Free disk space; restart the node for a new black box",
    "NODE.clock": "Check which node publishes /clock",
    "NODE.stamps": "Set the clock; for a played bag start the node with use_sim_time",
    "NODE.name": "Stop one of the two nodes",
    "NODE.overload": "Stop other programs on the computer; lower the rates; play a bag more slowly",
    "NODE.recovered": "Read the log for the failure; compare the alignment with the previous one",
    "NODE.software": "Keep the black box and report the problem",
    "NODE.sink.ID": "Check cable, port and disk, see /diagnostics; displays on this line show no values or old ones",
    "NODE.source.ID": "Check the instrument and its line; /diagnostics lists the sentences received",
    "disk.full": "Delete or move recordings",
}
"""Kind of an alert → advice."""

_ENDINGS = {"unreported": "SOURCE", "mended": "SOURCE", "rate": "SOURCE"}
_NODE_ENDINGS = ("box", "clock", "stamps", "name", "overload", "recovered", "software")


def kind_of(alert_id: str) -> str:
    """Return the kind of an alert, such as "star.ID.out" for "star.fore.out"; no key of :data:`ADVICE` if unknown."""
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
    return f"NODE.{ending}" if ending in _NODE_ENDINGS else ""


def advice_for(alert_id: str) -> str:
    """Return the advice for an alert, one line; empty for an unknown id."""
    return ADVICE.get(kind_of(alert_id), "")
