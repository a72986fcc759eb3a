"""[W18]: accuracy of the telescope's axis from two lights, by the paper's method and by ours, in several readings.

The sizes of zero-mean normal errors that are isotropic in a plane have a Rayleigh distribution, whose mean is 1.91
times its standard deviation. If the errors are not isotropic, the ratio is less.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.paper_method import mean_of_two_triads
from ship_testing.places import ROOT
from ship_testing.simulated_sightings import BASELINE_M, FOCAL_LENGTH_SIGMA_M, NONE, paper_epochs, truth_of
from ship_testing.trials.monte_carlo import pointing_errors
from theodolite_calib.filter.telescope_attitude import solve_attitude
from tools.papers.table import Row, rows_table, table

RAYLEIGH_RATIO = float(np.sqrt(np.pi / (4.0 - np.pi)))
"""Ratio of mean to standard deviation of a Rayleigh distribution."""

PRINTED_MEAN_ARCSEC, PRINTED_SIGMA_ARCSEC, PRINTED_TOTAL_ARCSEC = 5.90, 1.71, 6.15
LENS_M = 0.06
UNSURVEYED_LENS_M = np.full(3, LENS_M / np.sqrt(3.0))
"""Unsurveyed place of the lens, m: 60 mm in equal parts forward, up and right."""

ELEVATIONS_DEG = (10.0, 30.0, 60.0, 80.0)
SCENARIOS = ("lens_surveyed", "lens_unsurveyed")
_ELEVATION_DEG, _EPOCHS, _SEED = 30.0, 40_000, 18
_EPOCHS_OF_VARIANTS, _VOYAGES = 10_000, 8


@dataclass(frozen=True)
class PaperReading:
    """One reading of the paper's simulation.

    Attributes:
        name: name for tables and figures.
        baseline_sigma_m: sigma of the error of each baseline along each axis.
        unsurveyed_lens_m: part of the vector to N' that the method takes as zero, in the main frame, shape (3,).
        elevation_deg: elevation of the telescope's axis.
        focal_length_error_m: error of the focal length at all epochs; None for a random error at each epoch.
    """

    name: str
    baseline_sigma_m: float = BASELINE_M
    unsurveyed_lens_m: tuple[float, ...] = tuple(NONE.tolist())
    elevation_deg: float = _ELEVATION_DEG
    focal_length_error_m: float | None = None


SURVEYED = PaperReading("N′ surveyed, 2.7 cm per axis")
AS_A_NORM = PaperReading("N′ surveyed, 2.7 cm as a norm", BASELINE_M / float(np.sqrt(3.0)))
UNSURVEYED = replace(
    AS_A_NORM, name="N′ unsurveyed, 2.7 cm as a norm", unsurveyed_lens_m=tuple(UNSURVEYED_LENS_M.tolist())
)


@dataclass(frozen=True)
class AxisErrors:
    """Errors of the telescope's axis on the sky over many epochs by each method, arcsec, shape (n,)."""

    triads: FloatArray
    likelihood: FloatArray


@cache
def axis_errors(reading: PaperReading, epochs: int = _EPOCHS) -> AxisErrors:
    """Compute the errors of both methods over epochs of a reading."""
    truth = truth_of(np.full(epochs, 77.0), reading.elevation_deg, 0.0)
    constant_m = reading.focal_length_error_m
    drawn = paper_epochs(
        truth,
        _SEED,
        baseline_sigma_m=reading.baseline_sigma_m,
        unsurveyed_lens_m=np.array(reading.unsurveyed_lens_m),
        focal_length_sigma_m=FOCAL_LENGTH_SIGMA_M if constant_m is None else 0.0,
    )
    camera = replace(drawn.camera, focal_length_m=drawn.camera.focal_length_m + (constant_m or 0.0))
    lines = drawn.lines()
    found = {
        "triads": mean_of_two_triads(lines.direction_n, camera.directions(drawn.image.point_m)),
        "likelihood": solve_attitude(drawn.image, camera, lines).rotation_nt,
    }
    axis_n = truth.rotation_nt[:, :, 0]
    return AxisErrors(**{name: angle_between(axis_n, found_nt[:, :, 0]) / ARCSEC for name, found_nt in found.items()})


@dataclass(frozen=True)
class SuiteError:
    """Error and sigma of the core of ``optical_axis`` after voyages (RMS on the sky); number of rejected sightings."""

    error_arcsec: float
    sigma_arcsec: float
    rejected_count: int

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the cells of a table row."""
        return f"{self.error_arcsec:.2f}″", f"{self.sigma_arcsec:.2f}″", str(self.rejected_count)


@cache
def suite_error_arcsec(scenario: str, seeds: range) -> SuiteError:
    """Simulate voyages of a scenario in bags/scenarios, and filter them; return the errors."""
    voyages = [pointing_errors(load_scenario(ROOT / "bags" / "scenarios" / f"{scenario}.yaml"), seed) for seed in seeds]
    ends = np.array([[voyage.error_on_sky[-1], voyage.sigma_on_sky[-1]] for voyage in voyages]) / ARCSEC
    error_arcsec, sigma_arcsec = np.sqrt(np.mean(ends**2, axis=0))
    return SuiteError(float(error_arcsec), float(sigma_arcsec), sum(voyage.rejected_count for voyage in voyages))


def summary(sizes: FloatArray) -> tuple[float, float, float]:
    """Return mean, standard deviation and root mean square of sizes."""
    return float(sizes.mean()), float(sizes.std()), float(np.sqrt(np.mean(sizes**2)))


_COLUMNS = ("mean", "σ", "total", "mean/σ")


def section(figure: str) -> str:
    """Return the section of the page about this paper; ``figure`` is the path of its figure."""
    readings = table(("", *_COLUMNS), _readings())
    of_focal_length = table(("2.7 cm", "f wrong at all epochs by", *_COLUMNS), _constant_focal_lengths())
    voyages = table(("N′", "error on the sky", "stated σ", "rejected sightings"), _voyages())
    elevations = ", ".join(f"{each:.0f}" for each in ELEVATIONS_DEG)
    return f"""## [W18]: calibration of a theodolite by two airborne lights

N′ is the principal point of the lens, here 60 mm from the centre of the theodolite. The method is given its position
if *surveyed*, and assumes it at the centre if *unsurveyed*.

{rows_table(printed_values())}
### The figure of its simulation in two readings

Two lights are 2 km away, at (3°, 2°) and (−2°, −3°) from the axis. The errors are drawn independently at each of
{_EPOCHS} epochs: f 100 mm ± 0.1 mm, a tenth of a pixel of 6.5 µm, 2″ of refraction at each light.

The paper's method is the mean of two TRIADs, with (22) corrected ([errata](explanation/errata.md)). Ours is the suite's
maximum likelihood estimate, with f from the angle between the lights. Mean, standard deviation and root mean square
(total) of the error of the axis on the sky:

{readings}
![Errors of the telescope's axis in both readings]({figure})

At elevations of {elevations}° the total error of the paper's method is {_over_elevations(SURVEYED)} with N′ surveyed,
and {_over_elevations(UNSURVEYED)} with N′ unsurveyed.

**The printed total is mostly a constant.** Its mean is {PRINTED_MEAN_ARCSEC / PRINTED_SIGMA_ARCSEC:.2f} times its σ.
For normal errors with zero mean in a plane this ratio is at most √(π / (4 − π)) = {RAYLEIGH_RATIO:.2f}, reached if they
are isotropic (Rayleigh distribution). With a focal length that is wrong by the listed 0.1 mm at all epochs it is 2.0 to
2.2. An error of 0.2 to 0.3 mm would give about the printed values, but the paper lists no such error:

{of_focal_length}
The paper lists one constant error of this size: N′, 60 mm. Unsurveyed, with equal components forward, up and right, it
moves both lights equally, by {_constant_arcsec():.2f}″. Of fourteen directions of N′, along the axes and midway between
them, this one or its opposite fits best (a test). That is a strong hypothesis, not a proof.

The suite's results are therefore given for both cases. With N′ surveyed, one epoch has an error of 3.47″, the
theoretical bound, and more epochs reduce it. With N′ unsurveyed, the error of any method that uses only lights is at
least the constant, for any number of epochs. The scenarios [`lens_surveyed`](../bags/scenarios/lens_surveyed.yaml) and
[`lens_unsurveyed`](../bags/scenarios/lens_unsurveyed.yaml) are voyages of the two cases. Root mean square errors of the
core of `optical_axis` after sixty sightings, {_VOYAGES} voyages each:

{voyages}
No residual shows the error of the second row: all its sightings are consistent. The uncertainty of an unsurveyed N′
must be configured in `telescope.lens.sigma_m`; the stated σ then covers the error (a test).
"""


def _constant_focal_lengths() -> Iterator[tuple[str, ...]]:
    for words, reading in (("per axis", SURVEYED), ("as a norm", AS_A_NORM)):
        for error_mm in (0.1, 0.2, 0.3):
            constant = replace(reading, focal_length_error_m=1e-3 * error_mm)
            yield words, f"{error_mm:.1f} mm", *_three(axis_errors(constant, _EPOCHS_OF_VARIANTS).triads)


def _voyages() -> Iterator[tuple[str, ...]]:
    for words, scenario in zip(("surveyed", "unsurveyed"), SCENARIOS, strict=True):
        yield words, *suite_error_arcsec(scenario, range(_VOYAGES)).cells


def printed_values() -> Iterator[Row]:
    """Yield the values that the paper prints."""
    mean, sigma, total = summary(axis_errors(UNSURVEYED).triads)
    _, _, surveyed = summary(axis_errors(SURVEYED).triads)
    constant = "N′ unsurveyed"
    yield Row("mean error of the axis", f"{PRINTED_MEAN_ARCSEC:.2f}″", f"{mean:.2f}″", constant)
    yield Row("standard deviation of this error", f"{PRINTED_SIGMA_ARCSEC:.2f}″", f"{sigma:.2f}″", constant)
    squares = np.hypot(PRINTED_MEAN_ARCSEC, PRINTED_SIGMA_ARCSEC)
    yield Row(
        "total error (root mean square)", f"{PRINTED_TOTAL_ARCSEC:.2f}″", f"{total:.2f}″; N′ surveyed {surveyed:.2f}″",
        f"{constant}; printed mean and σ give {squares:.2f}″",
    )  # fmt: skip
    yield Row("stated limit of the total error", "10″", f"{total:.2f}″")
    yield Row(
        "error of a baseline to a light", "2.7 cm", f"at most {100.0 * baseline_end_m():.1f} cm as a norm",
        "RTK 1 cm per axis, levers 30 cm × (1°, 1°, 2°) and 5 m × (10″, 10″, 72″), each rotation at a right angle to "
        "its lever (the worst case)",
    )  # fmt: skip
    azimuth = f"{azimuth_of_tilt_arcsec():.2f}″"
    yield Row("azimuth error with the INS alone, 20″ of tilt, elevation 60°", "up to 35″", azimuth)


def baseline_end_m() -> float:
    """Return the norm of the error of a baseline's end due to the errors in the paper's list, m."""
    rtk_m = 0.01 * np.sqrt(3.0)
    drone_m = 0.3 * np.linalg.norm(np.deg2rad([1.0, 1.0, 2.0]))
    ship_m = 5.0 * np.linalg.norm(np.array([10.0, 10.0, 72.0]) * ARCSEC)
    return float(np.linalg.norm([rtk_m, drone_m, ship_m]))


def azimuth_of_tilt_arcsec(tilt_arcsec: float = 20.0, elevation_deg: float = 60.0) -> float:
    """Return the largest azimuth error of a direction due to a tilt of the horizon in any direction, arcsec."""
    azimuths = np.deg2rad(np.arange(0.0, 360.0))
    tilts_n = tilt_arcsec * ARCSEC * np.stack([np.cos(azimuths), np.zeros(360), np.sin(azimuths)], axis=-1)
    line_n = rotation_from_angles(*np.deg2rad([0.0, elevation_deg, 0.0]))[:, 0]
    seen_n = exp_rotation(tilts_n) @ line_n
    return float(np.max(np.abs(np.arctan2(seen_n[:, 2], seen_n[:, 0]))) / ARCSEC)


def _readings() -> Iterator[tuple[str, ...]]:
    for reading in (UNSURVEYED, SURVEYED):
        errors = axis_errors(reading)
        yield f"{reading.name}: the paper's method", *_three(errors.triads)
        yield f"{reading.name}: ours", *_three(errors.likelihood)
    mean, sigma = PRINTED_MEAN_ARCSEC, PRINTED_SIGMA_ARCSEC
    yield "printed", f"{mean:.2f}″", f"{sigma:.2f}″", f"{PRINTED_TOTAL_ARCSEC:.2f}″", f"{mean / sigma:.2f}"


def _three(sizes: FloatArray) -> tuple[str, ...]:
    mean, sigma, total = summary(sizes)
    return f"{mean:.2f}″", f"{sigma:.2f}″", f"{total:.2f}″", f"{mean / sigma:.2f}"


def _over_elevations(reading: PaperReading) -> str:
    totals = [
        summary(axis_errors(replace(reading, elevation_deg=each), _EPOCHS_OF_VARIANTS).triads)[2]
        for each in ELEVATIONS_DEG
    ]
    return f"{min(totals):.2f} to {max(totals):.2f}″"


def _constant_arcsec() -> float:
    return float(np.linalg.norm(UNSURVEYED_LENS_M[1:]) / 2000.0 / ARCSEC)
