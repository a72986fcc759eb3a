"""What the diagnostics say of the attitude itself, in words for the watch."""

from collections.abc import Mapping

from ship_attitude_star.samples import AttitudeEstimate, Decision, Status
from ship_node.diagnostics import Level
from ship_node.diagnostics import Status as DiagnosticStatus

_WORDS = {
    Status.VALID: (Level.OK, "VALID: INS and stars"),
    Status.COASTING: (Level.WARN, "COASTING: no stars, the INS carries on with growing uncertainty"),
    Status.DEGRADED: (Level.WARN, "DEGRADED"),
    Status.INVALID: (Level.ERROR, "INVALID: neither INS nor stars"),
}


def attitude_status(estimate: AttitudeEstimate | None, clock_jumps: int) -> DiagnosticStatus:
    """State of the published attitude."""
    values = {"clock jumps back": str(clock_jumps)}
    if estimate is None:
        return DiagnosticStatus("attitude", Level.WARN, "no INS sample yet", values)
    level, text = _WORDS[estimate.status]
    if estimate.status is Status.DEGRADED:
        text += ": INS alone, no star yet" if "ins" in estimate.sources else ": INS gone, stars alone"
    values |= {"sources": ", ".join(estimate.sources), "star age (s)": f"{estimate.star_age_s:.1f}"}
    return DiagnosticStatus("attitude", level, text, values)


def conflict_statuses(conflicts: Mapping[str, Decision]) -> list[DiagnosticStatus]:
    """One status for each source that keeps disagreeing with the INS."""
    return [DiagnosticStatus(f"conflict {source}", Level.ERROR, d.text) for source, d in sorted(conflicts.items())]
