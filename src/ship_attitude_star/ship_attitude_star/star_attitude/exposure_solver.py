"""Exposures against the sky: the attitude of one sensor, and of the deck by several."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from ship_attitude_star.measurements.device_config import JOINT
from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_attitude_star.ship_attitude.star_update import visible_stars
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.star_attitude.config import ObservingSensorConfig
from ship_attitude_star.star_attitude.results import RefusedStar, Solved
from ship_attitude_star.stars.camera import tangent_basis
from ship_attitude_star.stars.fit import SightedStars, square_roots
from ship_attitude_star.stars.selection import AttitudePrior
from ship_attitude_star.stars.solution import SolutionStatus, StarSolution, no_attitude, solve_stars
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class Sighting:
    """An exposure whose stars have their places in the sky.

    Attributes:
        exposure: the stars that can be used.
        stars: the same, in the sensor frame; None where there was no sky to compare them with.
        refused: stars that had no part in the solution of the sensor.
        turn_variance: of an error of all its directions alike, left by the correction for the length of the exposure,
            each axis, rad².
    """

    exposure: StarExposure
    stars: SightedStars | None
    refused: tuple[RefusedStar, ...]
    turn_variance: float = 0.0

    @property
    def source(self) -> str:
        """``star.<id>``."""
        return self.exposure.source

    @property
    def time_ns(self) -> int:
        """Stamp of the exposure."""
        return self.exposure.time_ns


@dataclass(frozen=True)
class Mounted:
    """A sighting in the deck frame of another moment.

    Attributes:
        sighting: the stars.
        rotation_ds: deck at that moment from sensor at its exposure, shape (3, 3).
        covariance_d: of this turn, rotation vector in the deck, rad², shape (3, 3).
    """

    sighting: Sighting
    rotation_ds: FloatArray
    covariance_d: FloatArray


def solve_exposure(
    exposure: StarExposure,
    refused: tuple[RefusedStar, ...],
    prior: AttitudePrior | None,
    watch: SkyWatch,
    turn_variance: float = 0.0,
) -> tuple[Sighting, Solved]:
    """The attitude of a sensor by one exposure.

    Args:
        exposure: its stars.
        refused: stars that were refused before.
        prior: attitude of the sensor that helps to choose.
        watch: the sky.
        turn_variance: of an error of all directions alike, new at each exposure, each axis, rad².
    """
    sensor_id, time_ns = exposure.source.partition(".")[2], exposure.time_ns
    refusal = watch.reason_against(time_ns)
    if refusal is not None:
        solution = no_attitude(np.zeros(len(exposure), dtype=bool), refusal)
        return Sighting(exposure, None, refused), Solved(sensor_id, time_ns, solution, refused, ())
    exposure, stars, invisible = visible_stars(exposure, watch, prior)
    refused += tuple(RefusedStar(exposure.source, time_ns, name, reason) for name, reason in invisible)
    solution, text = _solved(stars, prior)
    if turn_variance > 0.0:
        parts_n = solution.parts_n.copy()
        parts_n[0] += turn_variance * np.eye(3)
        solution = replace(solution, parts_n=parts_n)
    sighting = Sighting(exposure, stars, refused)
    rejected = _rejected(solution, [Mounted(sighting, np.eye(3), np.zeros((3, 3)))])
    sources = (exposure.source,) if solution.status is not SolutionStatus.INVALID else ()
    solved = Solved(sensor_id, time_ns, solution, refused + tuple(rejected), sources, text)
    return Sighting(exposure, stars, solved.refused, turn_variance), solved


def solve_deck(
    time_ns: int, group: Sequence[Mounted], sensors: dict[str, ObservingSensorConfig], prior: AttitudePrior | None
) -> Solved:
    """The attitude of the deck by exposures of different sensors.

    Args:
        time_ns: moment of the attitude.
        group: the exposures.
        sensors: how well their mounting is known, by id.
        prior: attitude of the deck that helps to choose.
    """
    seeing = [mounted for mounted in group if mounted.sighting.stars is not None]
    if not seeing:
        refusal = Refusal(Reason.TOO_FEW_STARS, "no exposure could be compared with the sky")
        return Solved(JOINT, time_ns, no_attitude(np.zeros(0, dtype=bool), refusal), (), ())
    solution, text = _solved(_in_deck(seeing, sensors), prior)
    rejected = _rejected(solution, seeing)
    known = {(star.source, star.name) for mounted in group for star in mounted.sighting.refused} if rejected else set()
    refused = tuple(star for star in rejected if (star.source, star.name) not in known)
    sources: tuple[str, ...] = ()
    if solution.status is not SolutionStatus.INVALID:
        members, rows = solution.members.tolist(), _rows(seeing)
        sources = tuple(m.sighting.source for m, own in zip(seeing, rows, strict=True) if any(members[own]))
    return Solved(JOINT, time_ns, solution, refused, sources, text)


def _solved(stars: SightedStars, prior: AttitudePrior | None) -> tuple[StarSolution, str]:
    """The solution, and what there is to say where the stars agree with one another but not with the prior."""
    solution = solve_stars(stars, prior)
    if prior is None or solution.status is not SolutionStatus.INVALID:
        return solution, ""
    alone = solve_stars(stars)
    if alone.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return solution, ""
    return alone, "the stars agree with one another, but not with ins/imu"


def _in_deck(group: Sequence[Mounted], sensors: dict[str, ObservingSensorConfig]) -> SightedStars:
    """All stars in the deck frame, with the errors of their sensors' mounting and of the way to this moment."""
    stars = [mounted.sighting.stars for mounted in group if mounted.sighting.stars is not None]
    mounting_b = np.empty((len(group), 3, 3))
    for index, mounted in enumerate(group):
        sigma_s = sensors[mounted.sighting.source.partition(".")[2]].installation_sigma_s
        turned = mounted.rotation_ds * sigma_s
        exact = not mounted.covariance_d.any()
        mounting_b[index] = turned if exact else square_roots(turned @ turned.T + mounted.covariance_d)
    return SightedStars(
        measured_b=np.concatenate([s.measured_b @ m.rotation_ds.T for s, m in zip(stars, group, strict=True)]),
        reference_n=np.concatenate([s.reference_n for s in stars]),
        sigma=np.concatenate([s.sigma for s in stars]),
        position_sigma=np.concatenate([s.position_sigma for s in stars]),
        shared_n=np.concatenate([s.shared_n for s in stars]),
        sensor=np.repeat(np.arange(len(stars)), [len(s) for s in stars]),
        mounting_b=mounting_b,
        smear_b=_smear_in_deck(stars, group),
    )


def _smear_in_deck(stars: Sequence[SightedStars], group: Sequence[Mounted]) -> FloatArray | None:
    """What streaks add to the errors of all stars, in the deck frame, rad², shape (k, 3, 3); None where none does."""
    if all(s.smear_b is None for s in stars):
        return None
    return np.concatenate(
        [
            np.zeros((len(s), 3, 3)) if s.smear_b is None else m.rotation_ds @ s.smear_b @ m.rotation_ds.T
            for s, m in zip(stars, group, strict=True)
        ]
    )


def _rows(group: Sequence[Mounted]) -> list[slice]:
    """Where the stars of each sensor stand among all."""
    ends = list(accumulate(len(mounted.sighting.exposure) for mounted in group))
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _rejected(solution: StarSolution, group: Sequence[Mounted]) -> list[RefusedStar]:
    """The stars that a solution rejects, each with its residual in the frame of its sensor."""
    rejected: list[RefusedStar] = []
    if not solution.rejected:
        return rejected
    for mounted, rows in zip(group, _rows(group), strict=True):
        exposure, stars = mounted.sighting.exposure, mounted.sighting.stars
        assert stars is not None
        rotation_ns = solution.rotation_nb @ mounted.rotation_ds
        for row in range(len(exposure)):
            refusal = solution.rejected.get(rows.start + row)
            if refusal is not None:
                predicted_s = stars.reference_n[row] @ rotation_ns
                residual = tangent_basis(predicted_s) @ (stars.measured_b[row] - predicted_s)
                rejected.append(
                    RefusedStar(
                        source=exposure.source,
                        time_ns=exposure.time_ns,
                        name=exposure.name(row),
                        refusal=refusal,
                        residual=tuple(residual.tolist()),
                        sigma=float(stars.white_sigma[row]),
                    )
                )
    return rejected
