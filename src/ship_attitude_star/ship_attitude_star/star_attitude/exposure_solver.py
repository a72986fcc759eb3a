"""Exposures against the sky: the attitude of one sensor, the attitude of the deck by several, and the stars refused."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate

import numpy as np

from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.star_attitude.config import ObservingSensorConfig
from ship_attitude_star.stars.camera import tangent_basis
from ship_attitude_star.stars.config import JOINT
from ship_attitude_star.stars.exposure import StarExposure, visible_stars
from ship_attitude_star.stars.fit import SightedStars, square_roots
from ship_attitude_star.stars.scale_check import contradicted_scale
from ship_attitude_star.stars.selection import StarPrior
from ship_attitude_star.stars.solution import SolutionStatus, StarSolution, no_attitude, solve_in_doubt_alone
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import FloatArray

_SAME_FRAME: FloatArray = np.eye(3)
_AGAINST_INS = "the stars are consistent with each other, but not with ins/imu"


@dataclass(frozen=True)
class RefusedStar:
    """A star that had no part in a solution.

    Attributes:
        source: ``star.<id>``, the sensor that saw it.
        time_ns: stamp of the exposure.
        name: which star, for people.
        refusal: why.
        residual: measured minus predicted direction, up and right in the sensor, rad; empty where it was not compared.
        sigma: standard deviation of each of the two, rad; NaN where it was not compared.
    """

    source: str
    time_ns: int
    name: str
    refusal: Refusal
    residual: tuple[float, ...] = ()
    sigma: float = float("nan")


@dataclass(frozen=True)
class Solved:
    """An attitude from stars: of a sensor, or of the deck by several.

    Attributes:
        sensor_id: which sensor, or JOINT.
        time_ns: moment of validity: the stamp of the exposure, of a joint solution that of its first exposure.
        solution: the attitude.
        refused: stars that had no part in it.
        sources: the sensors whose stars have a part in it, ``star.<id>``.
        text: what else is to be said, for people; mostly empty.
    """

    sensor_id: str
    time_ns: int
    solution: StarSolution
    refused: tuple[RefusedStar, ...]
    sources: tuple[str, ...]
    text: str = ""

    @property
    def valid(self) -> bool:
        """Whether there is an attitude."""
        return self.solution.status is not SolutionStatus.INVALID


@dataclass
class StarOutcome:
    """What one input of the core led to.

    Attributes:
        refusal: why this very input was not used; None where it was used, or still waits.
        solved: solutions to publish, in order.
        not_joined: exposures (source, stamp) that came too late for the joint solution of their time.
    """

    refusal: Refusal | None = None
    solved: list[Solved] = field(default_factory=list)
    not_joined: list[tuple[str, int]] = field(default_factory=list)


@dataclass(frozen=True)
class PlacedExposure:
    """An exposure whose stars have their places in the sky.

    Attributes:
        source: ``star.<id>``.
        time_ns: stamp of the exposure.
        exposure: the stars that can be used.
        stars: the same stars with their places, in the sensor frame; None where no star can be placed in the sky.
        refused: stars that had no part in the solution of the sensor.
        turn_variance: variance of an error that turns all directions alike, each axis, rad². The correction for the
            length of the exposure leaves it, beside the noise of the INS.
    """

    source: str
    time_ns: int
    exposure: StarExposure
    stars: SightedStars | None
    refused: tuple[RefusedStar, ...]
    turn_variance: float = 0.0


@dataclass(frozen=True)
class Mounted:
    """An exposure in the deck frame of another moment.

    Attributes:
        placed: the exposure.
        rotation_ds: deck at that moment from sensor at its exposure, shape (3, 3).
    """

    placed: PlacedExposure
    rotation_ds: FloatArray


def not_solved(
    exposure: StarExposure, refused: tuple[RefusedStar, ...], refusal: Refusal
) -> tuple[PlacedExposure, Solved]:
    """What becomes of an exposure that is refused as a whole: no attitude, and nothing to join."""
    solution = no_attitude(np.zeros(len(exposure), dtype=bool), refusal)
    placed = PlacedExposure(exposure.source, exposure.time_ns, exposure, None, refused)
    return placed, Solved(exposure.source.partition(".")[2], exposure.time_ns, solution, refused, ())


def solve_exposure(
    exposure: StarExposure,
    refused: tuple[RefusedStar, ...],
    prior: StarPrior | None,
    watch: SkyWatch,
    noise_variance: float = 0.0,
    turn_variance: float = 0.0,
) -> tuple[PlacedExposure, Solved]:
    """The attitude of a sensor by one exposure.

    Args:
        exposure: its stars.
        refused: stars that were refused before.
        prior: attitude of the sensor that helps to choose among the stars; None where it is not known.
        watch: the sky.
        noise_variance: variance that the noise of the INS gives to a turn of all directions alike, each axis, rad².
        turn_variance: the same of another such error, new at each exposure.
    """
    source, time_ns = exposure.source, exposure.time_ns
    sensor_id = source.partition(".")[2]
    visible = visible_stars(exposure, watch, prior)
    if isinstance(visible, Refusal):
        return not_solved(exposure, refused, visible)
    detections = exposure
    exposure, stars, invisible = visible
    if invisible:
        refused += tuple(RefusedStar(source, time_ns, name, refusal) for name, refusal in invisible)
    solution, against_prior = solve_in_doubt_alone(stars, prior)
    contradicted = contradicted_scale(detections, watch, prior, solution.star_count)
    if contradicted is not None:
        return not_solved(detections, refused, contradicted)
    if noise_variance + turn_variance > 0.0:
        solution = solution.with_more_noise(noise_variance + turn_variance)
    placed = PlacedExposure(source, time_ns, exposure, stars, refused, turn_variance)
    if solution.rejected:
        refused += tuple(_rejected(solution, [Mounted(placed, _SAME_FRAME)]))
        placed = replace(placed, refused=refused)
    sources = (source,) if solution.status is not SolutionStatus.INVALID else ()
    return placed, Solved(sensor_id, time_ns, solution, refused, sources, _AGAINST_INS if against_prior else "")


def solve_deck(
    time_ns: int,
    group: Sequence[Mounted],
    turn_covariance_d: FloatArray,
    sensors: dict[str, ObservingSensorConfig],
    prior: StarPrior | None,
) -> Solved:
    """The attitude of the deck by exposures of different sensors.

    Args:
        time_ns: moment of the attitude.
        group: the m exposures.
        turn_covariance_d: of the errors of the turns to this moment, rotation vectors in the deck, rad², shape
            (m, 3, m, 3).
        sensors: parameters of the sensors by id; they tell how well the mounting is known.
        prior: attitude of the deck that helps to choose among the stars; None where it is not known.
    """
    with_stars = [index for index, mounted in enumerate(group) if mounted.placed.stars is not None]
    seeing = group
    if len(with_stars) < len(group):
        seeing = [group[index] for index in with_stars]
        turn_covariance_d = turn_covariance_d[with_stars][:, :, with_stars]
    if not seeing:
        refusal = Refusal(Reason.TOO_FEW_STARS, "no exposure could be compared with the sky")
        return Solved(JOINT, time_ns, no_attitude(np.zeros(0, dtype=bool), refusal), (), ())
    solution, against_prior = solve_in_doubt_alone(_in_deck(seeing, turn_covariance_d, sensors), prior)
    rejected = _rejected(solution, seeing)
    known = {(star.source, star.name) for mounted in group for star in mounted.placed.refused} if rejected else set()
    refused = tuple(star for star in rejected if (star.source, star.name) not in known)
    sources: tuple[str, ...] = ()
    if solution.status is not SolutionStatus.INVALID:
        members, rows = solution.members.tolist(), _rows(seeing)
        sources = tuple(m.placed.source for m, own in zip(seeing, rows, strict=True) if any(members[own]))
    return Solved(JOINT, time_ns, solution, refused, sources, _AGAINST_INS if against_prior else "")


def _in_deck(
    group: Sequence[Mounted], turn_covariance_d: FloatArray, sensors: dict[str, ObservingSensorConfig]
) -> SightedStars:
    """All stars in the deck frame, with the errors of their sensors' mounting and of the turns to this moment."""
    stars = [mounted.placed.stars for mounted in group if mounted.placed.stars is not None]
    mounting_b = np.empty((len(group), 3, 3))
    for index, mounted in enumerate(group):
        mounting_b[index] = mounted.rotation_ds * sensors[mounted.placed.source.partition(".")[2]].installation_sigma_s
    return SightedStars(
        measured_b=np.concatenate([s.measured_b @ m.rotation_ds.T for s, m in zip(stars, group, strict=True)]),
        reference_n=np.concatenate([s.reference_n for s in stars]),
        sigma=np.concatenate([s.sigma for s in stars]),
        position_sigma=np.concatenate([s.position_sigma for s in stars]),
        shared_n=np.concatenate([s.shared_n for s in stars]),
        sensor=np.repeat(np.arange(len(stars), dtype=np.intp), [len(s) for s in stars]),
        mounting_b=mounting_b,
        smear_b=_smear_in_deck(stars, group),
        turned_b=_turned_in_deck(group, turn_covariance_d),
        rivals=_rivals(stars),
        pixel_sigma=_pixel_sigma(stars),
        field_b=_field_in_deck(stars, group),
        field_sources=tuple(source for s in stars for source in s.field_sources),
    )


def _turned_in_deck(group: Sequence[Mounted], turn_covariance_d: FloatArray) -> FloatArray | None:
    """Turn of each of m exposures by one sigma of each error of the turns, rad, (m, 3, 3 m); None where none errs."""
    own = [mounted.placed.turn_variance for mounted in group]
    if not (any(own) or turn_covariance_d.any()):
        return None
    size = 3 * len(group)
    covariance_d = turn_covariance_d.reshape(size, size) + np.diag(np.repeat(own, 3))
    return square_roots(covariance_d).reshape(len(group), 3, size)


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


def _rivals(stars: Sequence[SightedStars]) -> FloatArray | None:
    """What may be taken for these stars, per steradian, shape (k,); None where the names of all are sure."""
    if all(s.rivals is None for s in stars):
        return None
    return np.concatenate([np.zeros(len(s)) if s.rivals is None else s.rivals for s in stars])


def _pixel_sigma(stars: Sequence[SightedStars]) -> FloatArray | None:
    """Pixel-spatial errors of all stars, rad per axis, shape (k,); None where no sensor has one."""
    if all(s.pixel_sigma is None for s in stars):
        return None
    return np.concatenate([np.zeros(len(s)) if s.pixel_sigma is None else s.pixel_sigma for s in stars])


def _field_in_deck(stars: Sequence[SightedStars], group: Sequence[Mounted]) -> FloatArray | None:
    """Displacement of each sensor's stars by the lasting errors of its camera, in the deck frame, rad, (k, 3, f)."""
    count = sum(len(s.field_sources) for s in stars)
    if not count:
        return None
    of_all, begin, rows = np.zeros((sum(len(s) for s in stars), 3, count)), 0, _rows(group)
    for s, mounted, own in zip(stars, group, rows, strict=True):
        if s.field_b is not None:
            end = begin + len(s.field_sources)
            of_all[own, :, begin:end] = mounted.rotation_ds @ s.field_b
            begin = end
    return of_all


def _rows(group: Sequence[Mounted]) -> list[slice]:
    """The rows of each sensor's stars among the stars of all sensors."""
    ends = list(accumulate(len(mounted.placed.exposure) for mounted in group))
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _rejected(solution: StarSolution, group: Sequence[Mounted]) -> list[RefusedStar]:
    """The stars that a solution rejects, each with its residual in the frame of its sensor."""
    rejected: list[RefusedStar] = []
    if not solution.rejected:
        return rejected
    for mounted, rows in zip(group, _rows(group), strict=True):
        exposure, stars = mounted.placed.exposure, mounted.placed.stars
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
                        sigma=float(stars.lone_sigma[row]),
                    )
                )
    return rejected
