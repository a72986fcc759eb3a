"""How far the ship's attitude may be wrong although nothing says so: protection levels of heading, pitch and roll.

The rows of the filter's state (:mod:`ship_attitude_star.ship_attitude.suspects`) tell how far the attitude would be
another one without each of its sources; :mod:`ship_estimation.protection` makes levels of that.
"""

from ship_attitude_star.measurements.samples import AttitudeEstimate
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.compiled_integrity import apart
from ship_estimation.outcome import Status
from ship_estimation.protection import Hypotheses, IntegrityReport, integrity_report
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation

QUANTITIES = ("heading", "pitch", "roll")
"""What the levels bound."""

_LEAST_SOURCES = 2
"""Beside the INS: with fewer nothing checks the one that there is."""


def integrity_of(filter_: ShipFilter, config: ShipAttitudeConfig, estimate: AttitudeEstimate) -> IntegrityReport:
    """The integrity of an attitude.

    Args:
        filter_: the filter and its model.
        config: its configuration.
        estimate: the attitude, which rests on a state of the filter.
    """
    state, table = estimate.state, filter_.suspects.table
    others = [name for name in estimate.sources if name in filter_.devices and name not in state.excluded]
    rows = [row - 1 for row in table.singles if table.names[row - 1] not in state.excluded]
    rows += [row - 1 for row in table.pairs_in_question(others, state.excluded)]
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    to_angles = angle_errors_from_rotation_vector(heading, pitch)
    parts = len(state.stack) - len(state.means) + 1
    # What the rows dispute is covered by the levels already. What an attitude adds to the error of the state, as the
    # noise of the INS, is the same in every row.
    beside = apart(
        filter_.model.rows("ins.attitude"),
        to_angles,
        to_angles,
        estimate.undisputed_n,
        state.mean,
        state.means[1:],
        state.stack[:parts],
        state.stack[parts:],
    )
    excluded = {name: exclusion.since_ns for name, exclusion in state.excluded.items()}
    checked = _checked(filter_, state, estimate, others)
    hypotheses = Hypotheses(table.names, table.k, *beside)
    return integrity_report(estimate.time_ns, config.integrity, hypotheses, rows, excluded, checked)


def _checked(filter_: ShipFilter, state: FilterState, estimate: AttitudeEstimate, others: list[str]) -> bool:
    """Whether the sources beside the INS that an attitude rests on check one another."""
    by_stars = any(filter_.devices[source].is_star for source in others)
    in_dispute = state.doubt is not None or state.jumped or estimate.status is Status.INVALID
    return by_stars and len(others) >= _LEAST_SOURCES and not in_dispute
