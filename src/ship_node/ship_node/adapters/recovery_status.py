"""Diagnostics of the second estimator of a node."""

from collections.abc import Callable, Mapping, Set

from ship_estimation.recovery.recovery import EstimatorRecovery
from ship_geometry.rotations import ARCSEC
from ship_node.messages.common_messages import DiagnosticStatus, Level

_ADOPTION_SHOWN_NS = 60_000_000_000
"""Time for which an adoption is reported as new, by the timeout clock, ns."""

_Remedy = Callable[[Mapping[str, float]], str]
"""Returns the advice for the operator about sources that have moved, from source → shift, rad."""


def recovery_counts(recovery: EstimatorRecovery) -> dict[str, str]:
    """Return the number of troubles in which a second estimator was started, and the number of adoptions."""
    return {"second estimators started": str(recovery.started), "second estimators adopted": str(recovery.adopted)}


def recovery_status(
    recovery: EstimatorRecovery, excluded: Set[str], remedy: _Remedy, waiting_ns: int
) -> DiagnosticStatus:
    """Return the diagnostic status of the recovery.

    Args:
        recovery: the recovery.
        excluded: sources that the current estimator excludes.
        remedy: returns the advice for the operator.
        waiting_ns: time by the timeout clock.
    """
    values = recovery_counts(recovery)
    if recovery.adopted_ns is not None and waiting_ns - recovery.adopted_ns <= _ADOPTION_SHOWN_NS:
        values["recovered after [s]"] = f"{recovery.recovery_time_s:.0f}"
    for name, moved_rad in sorted(recovery.displaced.items()):
        values[f"{name} moved [arcsec]"] = f"{moved_rad / ARCSEC:.1f}"
    if recovery.is_in_trouble:
        text = f"a second estimator runs: {trouble_text(recovery.displaced, excluded, remedy)}"
        return DiagnosticStatus("recovery", Level.WARN, text, values)
    text = "no second estimator runs"
    if recovery.adopted:
        text += f"; the last one was adopted after {recovery.recovery_time_s:.0f} s"
    return DiagnosticStatus("recovery", Level.OK, text, values)


def trouble_text(displaced: Mapping[str, float], excluded: Set[str], remedy: _Remedy) -> str:
    """Return the cause of the trouble, with the advice for the operator; see :func:`recovery_status`."""
    if displaced:
        moved = ", ".join(f"{name} by {moved_rad / ARCSEC:.0f}″" for name, moved_rad in sorted(displaced.items()))
        return f"shifted: {moved}; {remedy(displaced)}"
    if excluded:
        return f"excluded: {', '.join(sorted(excluded))}"
    return "the output is not VALID although the inputs are good"
