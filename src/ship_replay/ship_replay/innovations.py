"""Innovations of a run: how well measurements agreed with their predictions, by source."""

import functools
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import chi2

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.stamps import ns_from_stamp
from ship_replay.times import NS_PER_S

WINDOW_S = 60
"""Length of the windows in which the mean NIS is judged, s."""

_LEAST_WINDOW_SAMPLES = 10
_BAND = 0.999


@dataclass
class SourceInnovations:
    """Innovations of one source; of a measurement judged more than once, the last judgement.

    Attributes:
        components: names of the residual's components.
        compared: stamp → (residual, sigma, nis) of those that were accepted.
        refused: name of the reason → count.
    """

    components: list[str] = field(default_factory=list)
    compared: dict[int, tuple[FloatArray, FloatArray, float]] = field(default_factory=dict)
    refused: Counter[str] = field(default_factory=Counter)

    def since(self, start_ns: int) -> "SourceInnovations":
        """Those stamped at or after a time; the counts of refusals are of the whole run."""
        kept = {stamp_ns: value for stamp_ns, value in self.compared.items() if stamp_ns >= start_ns}
        return SourceInnovations(self.components, kept, self.refused)

    def arrays(self) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray]:
        """Stamps (n,) in ns, residuals and sigmas (n, k) in rad, NIS (n,), in order of stamps."""
        stamps = sorted(self.compared)
        count = (len(stamps), len(self.components))
        residuals = np.array([self.compared[stamp][0] for stamp in stamps]).reshape(count)
        sigmas = np.array([self.compared[stamp][1] for stamp in stamps]).reshape(count)
        return np.array(stamps, dtype=np.int64), residuals, sigmas, np.array([self.compared[s][2] for s in stamps])

    def statistics(self) -> dict[str, float]:
        """Quantity → value: counts, mean and deviation of each residual, NIS."""
        time_ns, residuals, sigmas, nis = self.arrays()
        values = {"accepted": float(len(time_ns)), "refused": float(sum(self.refused.values()))}
        for column, name in enumerate(self.components):
            residual, sigma = residuals[:, column], sigmas[:, column]
            residual, sigma = residual[np.isfinite(residual)] / ARCSEC, sigma[np.isfinite(residual)] / ARCSEC
            if len(residual):
                values[f"{name}.mean_arcsec"] = float(np.mean(residual))
                values[f"{name}.std_arcsec"] = float(np.std(residual))
                values[f"{name}.sigma_arcsec"] = float(np.sqrt(np.mean(sigma**2)))
        if len(nis):
            degrees = np.sum(np.isfinite(residuals), axis=1)
            values["nis_mean"] = float(np.mean(nis))
            values["nis_degrees"] = float(np.mean(degrees))
            share = windows_in_band(time_ns, nis, degrees)
            if share is not None:
                values["nis_windows_in_band"] = share
        return values


class InnovationBook:
    """Collects Innovation messages by source."""

    def __init__(self) -> None:
        self.sources: dict[str, SourceInnovations] = {}

    def add(self, message: Any) -> None:
        """One message ship_msgs/Innovation."""
        source = self.sources.setdefault(message.source, SourceInnovations())
        stamp_ns = ns_from_stamp(message.header.stamp)
        if message.accepted and len(message.residual):
            source.components = list(message.components)
            source.compared[stamp_ns] = (np.array(message.residual), np.array(message.sigma), float(message.nis))
            return
        if not message.accepted:
            source.refused[reason_name(message)] += 1
            if message.reason == message.GATE or message.reason == message.REVISED:
                # A later judgement of a measurement that was accepted at first.
                source.compared.pop(stamp_ns, None)


def reason_name(message: Any) -> str:
    """Name of an Innovation's reason as ``input_health`` writes it, e.g. ``gate``."""
    return _reason_names(type(message)).get(message.reason, f"reason {message.reason}")


@functools.cache
def _reason_names(message_class: type) -> dict[int, str]:
    constants = vars(message_class).items()
    return {value: name.lower() for name, value in constants if name.isupper() and isinstance(value, int)}


def windows_in_band(time_ns: np.ndarray, nis: FloatArray, degrees: np.ndarray) -> float | None:
    """Share of one-minute windows whose mean NIS lies in its 99.9 % band; None where no window is full enough."""
    window = (time_ns - time_ns[0]) // (WINDOW_S * NS_PER_S)
    inside = []
    for number in np.unique(window):
        members = window == number
        if np.sum(members) >= _LEAST_WINDOW_SAMPLES:
            tail = 0.5 * (1.0 - _BAND)
            low, high = chi2.ppf([tail, 1.0 - tail], np.sum(degrees[members]))
            inside.append(low <= np.sum(nis[members]) <= high)
    return float(np.mean(inside)) if inside else None
