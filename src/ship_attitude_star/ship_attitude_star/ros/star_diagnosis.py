"""What the diagnostics say of solutions from stars, in words for the watch."""

from collections.abc import Mapping, Sequence

from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import Solved
from ship_attitude_star.stars.config import JOINT
from ship_attitude_star.stars.solution import SolutionStatus
from ship_geometry.rotations import ARCSEC
from ship_node.edge.messages_out import DiagnosticStatus, Level

_WORDS = {
    SolutionStatus.VALID: (Level.OK, "VALID"),
    SolutionStatus.UNVERIFIED: (Level.WARN, "UNVERIFIED: too few stars to tell a misidentified one"),
    SolutionStatus.ANGLES_SINGULAR: (Level.OK, "ANGLES_SINGULAR: near the zenith azimuth and roll mean nothing"),
    SolutionStatus.INVALID: (Level.WARN, "INVALID"),
}


SILENT_NS = 10_000_000_000
"""A solution put out longer ago than this says nothing of now, ns."""


def solution_statuses(
    config: StarAttitudeConfig, latest: Mapping[str, tuple[Solved, int]], joined_by_ins: bool, waiting_ns: int
) -> list[DiagnosticStatus]:
    """State of each sensor's last solution, and of the joint one.

    Args:
        config: the sensors.
        latest: last solutions by id, each with the time of waiting when it was put out.
        joined_by_ins: whether ``ins/imu`` moved the last exposures to one moment.
        waiting_ns: the time of waiting now.
    """
    how = ""
    if len(config.star_sensors) > 1 and not joined_by_ins:
        how = f"; without ins/imu only exposures within {1e3 * config.joint.simultaneous_s:g} ms are joined"
    ids = (*config.star_sensors, JOINT)
    return [_status(id_, latest.get(id_), how if id_ == JOINT else "", waiting_ns) for id_ in ids]


def sky_status(not_measured: Sequence[str], clock_jumps: int) -> DiagnosticStatus:
    """What the places of stars rest on.

    Args:
        not_measured: quantities of the air that come from parameters.
        clock_jumps: how often the clock went back.
    """
    text = "weather as measured"
    if not_measured:
        text = f"no weather: {', '.join(not_measured)} by parameters, with their larger sigma"
    return DiagnosticStatus("sky", Level.OK, text, {"clock jumps back": str(clock_jumps)})


def _status(id_: str, last: tuple[Solved, int] | None, how: str, waiting_ns: int) -> DiagnosticStatus:
    name = f"solution {id_}"
    if last is None:
        return DiagnosticStatus(name, Level.OK, f"none yet{how}")
    solved, put_out_ns = last
    if waiting_ns - put_out_ns > SILENT_NS:
        text = f"none for {(waiting_ns - put_out_ns) * 1e-9:.0f} s, {solved.solution.status.name} before{how}"
        return DiagnosticStatus(name, Level.WARN, text)
    level, text = _WORDS[solved.solution.status]
    if solved.solution.refusal is not None:
        text += f": {solved.solution.refusal.text}"
    if solved.text:
        level, text = Level.WARN, f"{text}; {solved.text}"
    values = {
        "stars used": str(solved.solution.star_count),
        "stars refused": str(len(solved.refused)),
        "sensors": ", ".join(solved.sources),
        'residual rms (")': f"{solved.solution.residual_rms / ARCSEC:.2f}",
    }
    return DiagnosticStatus(name, level, text + how, values)
