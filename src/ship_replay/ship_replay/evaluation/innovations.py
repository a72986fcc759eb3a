"""Innovations of a run: how well measurements agreed with their predictions, by source."""

import functools
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import chi2

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_geometry.rotations import ARCSEC, FloatArray

WINDOW_S = 60
"""Length of the windows in which the mean NIS is judged, s."""

_LEAST_WINDOW_SAMPLES = 10
_BAND = 0.999


@dataclass(frozen=True)
class Judged:
    """A measurement that was used.

    Attributes:
        components: of its residual; of single stars only the axis, whichever star it was.
        residual: rad, one a component; NaN where not measured.
        sigma: predicted, rad.
        nis: normalised innovation squared.
    """

    components: tuple[str, ...]
    residual: FloatArray
    sigma: FloatArray
    nis: float


@dataclass
class SourceInnovations:
    """Innovations of one source; of a measurement judged more than once, the last judgement.

    Attributes:
        compared: stamp → those that were accepted.
        refused: name of the reason → count.
    """

    compared: dict[int, Judged] = field(default_factory=dict)
    refused: Counter[str] = field(default_factory=Counter)

    def since(self, start_ns: int) -> "SourceInnovations":
        """Those stamped at or after a time; the counts of refusals are of the whole run."""
        kept = {stamp_ns: value for stamp_ns, value in self.compared.items() if stamp_ns >= start_ns}
        return SourceInnovations(kept, self.refused)

    def components(self) -> list[str]:
        """Names of all components that occur, in order of their first occurrence."""
        return list(dict.fromkeys(name for judged in self.compared.values() for name in judged.components))

    def series(self, component: str) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Stamps (ns), residuals and sigmas (rad) of a component, in order of stamps, without those not measured."""
        rows = [
            (stamp_ns, residual, sigma)
            for stamp_ns, judged in sorted(self.compared.items())
            for name, residual, sigma in zip(judged.components, judged.residual, judged.sigma, strict=True)
            if name == component and np.isfinite(residual)
        ]
        stamps = np.array([row[0] for row in rows], dtype=np.int64)
        return stamps, np.array([row[1] for row in rows]), np.array([row[2] for row in rows])

    def statistics(self) -> dict[str, float]:
        """Quantity → value: counts, mean and deviation of each residual, NIS."""
        values = {"accepted": float(len(self.compared)), "refused": float(sum(self.refused.values()))}
        for name in self.components():
            _, residual, sigma = self.series(name)
            if len(residual):
                values[f"{name}.mean_arcsec"] = float(np.mean(residual)) / ARCSEC
                values[f"{name}.std_arcsec"] = float(np.std(residual)) / ARCSEC
                values[f"{name}.sigma_arcsec"] = float(np.sqrt(np.mean(sigma**2))) / ARCSEC
        if self.compared:
            time_ns = np.array(sorted(self.compared), dtype=np.int64)
            nis = np.array([self.compared[stamp].nis for stamp in time_ns.tolist()])
            degrees = np.array([np.isfinite(self.compared[stamp].residual).sum() for stamp in time_ns.tolist()])
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
            axes = tuple(name.rpartition(" ")[2] for name in message.components)
            residual, sigma = np.array(message.residual), np.array(message.sigma)
            source.compared[stamp_ns] = Judged(axes, residual, sigma, float(message.nis))
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
