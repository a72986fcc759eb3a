"""Installation angles from a session: each angle, and combinations of angles.

The observability of a combination follows from the covariances before and after the session. Differences between star
sensors are free of the INS's errors. A common rotation of all sensors on the deck is observed only against an attitude
of the deck. At constant heading the INS's error and a common installation error are not separable
(docs/explanation/filter.md). So the joint error of all installations is split, e = C t + r. The vector t is a common
rotation about the deck's axes, and C transforms t into the axes of each sensor. Under the prior covariance P0 the two
parts are independent:

    relative   r, with C^T P0^-1 r = 0, of 3 (N - 1) dimensions, in its principal directions
    common     t for known r, with the covariance (C^T P^-1 C)^-1

The sigma of each part is compared with its prior sigma. For t the prior includes the configured errors of the INS:
(C^T P0^-1 C + Sigma_ins^-1)^-1, the covariance after one observation at constant heading.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.ship_attitude.alignment import Alignment, AlignmentPrior, current_alignment
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_bags.errors import BadInput
from ship_geometry.frames import angle_errors_from_rotation_vector, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, left_jacobian, wrap_pi
from ship_studies.installation.session import InputCount, Session

ANGLES = ("azimuth", "elevation", "roll")

_MIN_VARIANCE_SHARE = 0.25
"""Share of an angle's variance from which on a combination leaves the angle unresolved."""

_EXPECTED_SHARE = 0.01
"""Share of messages that the gate may reject without a warning: ten times the share expected by chance."""

NOT_OBSERVED_RATIO = 0.9
"""Ratio of the sigmas, after / before, from which on a quantity is not observed."""

WELL_OBSERVED_RATIO = 0.5
"""Ratio up to which a quantity is observed: three quarters of the variance are removed."""

DECK_AXES = ("bow", "up", "starboard")


@dataclass(frozen=True)
class JointRotation:
    """A simultaneous rotation of several sensors, as a possible joint error of the installations.

    Attributes:
        axis: axis of the deck for a common rotation of all sensors; None for a relative rotation.
        rotation_s: rotation vector of each sensor for one sigma, in the sensor's axes (forward, up, right), rad, shape
            (N, 3).
        sigma_before: prior standard deviation, rad.
        sigma: standard deviation after the session, rad.
        shares: share of each source of error in the variance, shape (n_sources,).
    """

    axis: str | None
    rotation_s: FloatArray
    sigma_before: float
    sigma: float
    shares: FloatArray

    @property
    def observability(self) -> str:
        """Observability: yes, partly or no."""
        return observability(self.sigma / self.sigma_before)


def combinations(
    prior_sigma: FloatArray, covariance_by_source: FloatArray, rotations_ds: FloatArray, ins_sigma_d: FloatArray
) -> list[JointRotation]:
    """Return the three common rotations of all sensors, then the relative rotations that were not well observed.

    The relative rotations are sorted, the worst first.

    Args:
        prior_sigma: prior sigma of each sensor's installation about its axes, rad, not zero, shape (N, 3).
        covariance_by_source: joint covariance after the session by source of error, rad², shape (n_sources, 3 N, 3 N).
        rotations_ds: deck from sensor, shape (N, 3, 3).
        ins_sigma_d: sigma of the INS error about the axes of the deck, rad, shape (3,).
    """
    scale = prior_sigma.ravel()
    whitened = covariance_by_source / np.outer(scale, scale)
    turn = np.concatenate([rotation.T for rotation in rotations_ds])
    # In units of the prior sigmas the prior is the unit matrix, and independent means orthogonal.
    turned = turn / scale[:, None]
    information = np.linalg.solve(whitened.sum(axis=0), turned)
    to_together = np.linalg.solve(turned.T @ information, information.T)
    # An INS without errors about an axis is an exact reference, which is not part of the prior.
    has_errors = ins_sigma_d > 0.0
    ins_information = np.diag(np.divide(1.0, ins_sigma_d**2, out=np.zeros(3), where=has_errors))
    before = np.linalg.inv(turned.T @ turned + ins_information)
    found = []
    for number, axis in enumerate(DECK_AXES):
        variances = _variances(whitened, to_together[number])
        sigma = float(np.sqrt(variances.sum()))
        run_s = (sigma * turn[:, number]).reshape(-1, 3)
        shares = variances / variances.sum()
        found.append(JointRotation(axis, run_s, float(np.sqrt(before[number, number])), sigma, shares))
    across = np.linalg.qr(turned, mode="complete")[0][:, len(DECK_AXES) :]
    return found + _relative_rotations(whitened, scale, across)


def _relative_rotations(whitened: FloatArray, scale: FloatArray, basis: FloatArray) -> list[JointRotation]:
    """Return the relative rotations of the sensors that were not well observed."""
    _, vectors = np.linalg.eigh(basis.T @ whitened.sum(axis=0) @ basis)
    found = []
    for vector in (basis @ vectors[:, ::-1]).T:
        variances = _variances(whitened, vector)
        ratio = float(np.sqrt(variances.sum()))
        if ratio > WELL_OBSERVED_RATIO:
            run = ratio * scale * vector * np.sign(vector[np.argmax(np.abs(scale * vector))])
            sigma = float(np.linalg.norm(run))
            found.append(JointRotation(None, run.reshape(-1, 3), sigma / ratio, sigma, variances / variances.sum()))
    return found


def _variances(covariance_by_source: FloatArray, functional: FloatArray) -> FloatArray:
    """Return the variance of a linear combination by source of error, shape (n_sources,)."""
    variances: FloatArray = np.einsum("i,kij,j->k", functional, covariance_by_source, functional)
    return variances


def observability(ratio: float) -> str:
    """Return the observability for a ratio of sigmas, after / before: yes, partly or no."""
    if ratio >= NOT_OBSERVED_RATIO:
        return "no"
    return "partly" if ratio > WELL_OBSERVED_RATIO else "yes"


@dataclass(frozen=True)
class InstalledAngle:
    """One installation angle of a star sensor.

    If the boresight is at the zenith, azimuth and roll are not separable: the sigmas of both are NaN.

    Attributes:
        sensor: id of the sensor.
        angle: azimuth, elevation or roll.
        configured: configured angle, rad.
        installed: angle found in the session, rad.
        sigma_before: configured standard deviation, rad.
        sigma: standard deviation after the session, rad.
        unresolved_in: labels of the poorly observed combinations that leave the angle unresolved.
    """

    sensor: str
    angle: str
    configured: float
    installed: float
    sigma_before: float
    sigma: float
    unresolved_in: tuple[str, ...]

    @property
    def correction_arcsec(self) -> float:
        """Installed minus configured angle, arcsec."""
        return float(wrap_pi(self.installed - self.configured)) / ARCSEC

    @property
    def observability(self) -> str:
        """Observability: yes, partly or no; empty if the angle is not separable from another."""
        if not np.isfinite(self.sigma):
            return ""
        observed = observability(self.sigma / self.sigma_before)
        return "partly" if observed == "yes" and self.unresolved_in else observed


@dataclass(frozen=True)
class InstallationCalibration:
    """Result of a session for all installations.

    Attributes:
        angles: angles of all star sensors.
        combinations: combinations by label, 1, 2, ….
        sensors: ids of the star sensors, in the order of the rows of the combinations.
        sources: sources of error, in the order of the shares of the combinations.
        covariance: joint covariance of all installation angles in the order of ``angles``, rad².
        prior: initial state of the next voyage.
        session: session from which the result is computed.
    """

    angles: list[InstalledAngle]
    combinations: dict[str, JointRotation]
    sensors: tuple[str, ...]
    sources: tuple[str, ...]
    covariance: FloatArray
    prior: AlignmentPrior
    session: Session

    @property
    def warnings(self) -> list[str]:
        """Problems of the session, one line each."""
        lines = [_gate_warning(source, count) for source, count in self.session.counts.items()]
        return [*(line for line in lines if line), *self.session.problems]


def calibrate(session: Session) -> InstallationCalibration:
    """Return the calibration of all installations from a session.

    Raises:
        BadInput: no measurement was used.
    """
    core, config = session.core, session.config
    prior = core.alignment_to_save()
    if prior is None:
        raise BadInput(f"{session.name}: no measurement was used: there is no alignment")
    sensors = tuple(config.star_sensors)
    ins = config.ins
    found = combinations(
        prior_sigma=np.array([star.installation_sigma_s for star in config.star_sensors.values()]),
        covariance_by_source=_installation_covariances(core, sensors),
        rotations_ds=np.array([prior.rotations_dv[f"star.{id_}"] for id_ in sensors]),
        ins_sigma_d=ARCSEC * np.array([ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec, ins.tilt_sigma_arcsec]),
    )
    labelled = {str(number): combination for number, combination in enumerate(found, start=1)}
    before, after = (
        current_alignment(core.filter, config, state) for state in (core.filter.initial_state(), core.state)
    )
    index = [after.names.index(f"star.{id_}.{angle}") for id_ in sensors for angle in ANGLES]
    return InstallationCalibration(
        angles=_installed_angles(before, after, index, labelled, sensors),
        combinations=labelled,
        sensors=sensors,
        sources=tuple(core.filter.model.sources),
        covariance=after.covariance[np.ix_(index, index)],
        prior=prior,
        session=session,
    )


def _installation_covariances(core: ShipAttitudeCore, sensors: tuple[str, ...]) -> FloatArray:
    """Return the joint covariance of the installations by source, in the installed axes, rad², (n_sources, 3 N, 3 N).

    The state vectors refer to the configured axes. In installed axes that differ by a degree, a rotation of the deck
    has other components than in the configured axes.
    """
    blocks = [core.filter.model.slices[f"star.{id_}.installation"] for id_ in sensors]
    to_axes = np.zeros((3 * len(sensors), core.filter.model.size))
    for number, block in enumerate(blocks):
        axes = slice(number * len(DECK_AXES), (number + 1) * len(DECK_AXES))
        to_axes[axes, block] = left_jacobian(core.state.mean[block]).T
    parts: FloatArray = to_axes @ core.state.covariance_by_source @ to_axes.T
    return parts


def _installed_angles(
    before: Alignment, after: Alignment, index: list[int], labelled: dict[str, JointRotation], sensors: tuple[str, ...]
) -> list[InstalledAngle]:
    configured, installed = before.values[index], after.values[index]
    sigma_before, sigma = (np.sqrt(np.diagonal(alignment.covariance)[index]) for alignment in (before, after))
    open_in: list[list[str]] = [[] for _ in index]
    for label, combination in labelled.items():
        if combination.observability != "yes":
            shares = (_angle_changes(combination, installed) / sigma) ** 2
            for row in np.flatnonzero(shares > _MIN_VARIANCE_SHARE).tolist():
                open_in[row].append(label)
    names = [(sensor, angle) for sensor in sensors for angle in ANGLES]
    return [
        InstalledAngle(
            sensor=sensor,
            angle=angle,
            configured=float(configured[row]),
            installed=float(installed[row]),
            sigma_before=float(sigma_before[row]),
            sigma=float(sigma[row]),
            unresolved_in=tuple(open_in[row]),
        )
        for row, (sensor, angle) in enumerate(names)
    ]


def _angle_changes(combination: JointRotation, angles: FloatArray) -> FloatArray:
    """Return the change of all angles by one sigma of a combination, rad, shape (3 N,)."""
    changes = []
    for run_s, (azimuth, elevation, roll) in zip(combination.rotation_s, angles.reshape(-1, 3), strict=True):
        run_d = rotation_from_angles(azimuth, elevation, roll) @ run_s
        changes.append(angle_errors_from_rotation_vector(azimuth, elevation) @ run_d)
    return np.concatenate(changes)


def _gate_warning(source: str, count: InputCount) -> str:
    """Return a warning if too many messages of a device were rejected as improbable; else an empty text."""
    total = count.used_count + count.improbable
    if count.improbable <= _EXPECTED_SHARE * total:
        return ""
    return (
        f"{source}: {count.improbable} of {total} messages were rejected as improbable: its installation or its noise "
        "is not as configured (installation: use --prior-sigma)"
    )
