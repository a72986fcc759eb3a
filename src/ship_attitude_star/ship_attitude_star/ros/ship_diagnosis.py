"""What the diagnostics say of the attitude itself, in words for the watch."""

import math
from collections.abc import Mapping, Sequence

from ship_attitude_star.measurements.samples import AttitudeDecision, AttitudeEstimate
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_estimation.outcome import Status
from ship_estimation.rate_guard import Rates
from ship_node.edge.messages_out import DiagnosticStatus, Level

_WORDS = {
    Status.VALID: (Level.OK, "VALID: INS and stars"),
    Status.COASTING: (Level.WARN, "COASTING: no stars, the INS carries on with growing uncertainty"),
    Status.DEGRADED: (Level.WARN, "DEGRADED"),
    Status.INVALID: (Level.ERROR, "INVALID: neither the INS nor stars give an attitude"),
}
_RATES = {
    Rates.UNPROVEN: (Level.OK, "not judged yet: too little motion, or none are given"),
    Rates.MEASURED: (Level.OK, "angular_velocity turns as the orientation does"),
    Rates.NOT_MEASURED: (
        Level.WARN,
        "angular_velocity does not turn as the orientation does: not used (zero, noise, other axes, another unit?)",
    ),
    Rates.WRONG_UNITS: (Level.ERROR, "angular_velocity is in another unit than rad/s: the INS is not used"),
}


def start_warnings(config: ShipAttitudeConfig) -> tuple[str, ...]:
    """What a configuration lacks, for the log at the start and for the diagnostics ever after."""
    if config.star_sensors or config.references:
        return ()
    lacking = "no star_sensors and no references are configured"
    return (f"{lacking}: the attitude will be the INS's alone, DEGRADED, horizon GRAVITY",)


def attitude_status(
    estimate: AttitudeEstimate | None, clock_jumps: int, lacking: Sequence[str] = ()
) -> DiagnosticStatus:
    """State of the published attitude.

    Args:
        estimate: the last one.
        clock_jumps: how often the clock went back.
        lacking: what the configuration lacks (:func:`start_warnings`).
    """
    values = {"clock jumps back": str(clock_jumps)}
    if estimate is None:
        return DiagnosticStatus("attitude", Level.WARN, "; ".join(["no INS sample yet", *lacking]), values)
    level, text = _WORDS[estimate.status]
    if estimate.status is Status.DEGRADED and lacking and "ins" in estimate.sources:
        text += f": {'; '.join(lacking)}"
    elif estimate.status is Status.DEGRADED:
        text += f": {_why_degraded(estimate)}"
    values |= {"sources": ", ".join(estimate.sources), "star age (s)": f"{estimate.star_age_s:.1f}"}
    return DiagnosticStatus("attitude", level, text, values)


def conflict_statuses(conflicts: Mapping[str, AttitudeDecision]) -> list[DiagnosticStatus]:
    """One status for each source that keeps disagreeing with the INS."""
    return [DiagnosticStatus(f"conflict {source}", Level.ERROR, d.text) for source, d in sorted(conflicts.items())]


def _why_degraded(estimate: AttitudeEstimate) -> str:
    if "ins" not in estimate.sources:
        return "INS gone, stars alone"
    if math.isnan(estimate.star_age_s):
        return "INS alone, no star yet"
    return "the attitude of the INS has jumped, and no star has confirmed it since"


def rates_status(rates: Rates) -> DiagnosticStatus:
    """What the angular velocities of the INS are worth."""
    return DiagnosticStatus("ins rates", *_RATES[rates])
