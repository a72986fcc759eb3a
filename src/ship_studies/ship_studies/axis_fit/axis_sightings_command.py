"""``axis_sightings``: table of sightings for ``fit_axes``, from a bag with lights.

The node ``optical_axis`` processes the bag and accepts or rejects every exposure. For each exposure with two lights or
more that are all accepted, the attitude of the telescope is computed from the lights alone. The ship's attitude
transforms the telescope's attitude to the deck. The main axis follows with the configured parallelism. The offsets of
the true direction from the encoder angles contain correlated errors: the deck's deformation, the ship's error, errors
of baselines, levers and refraction. The table therefore lists the effect of each such error on each sighting.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import ProgressWrapper, read_bag, with_bag_progress
from ship_bags.message_store import RosbagsFactory
from ship_bags.output_files import add_force_option, check_file, write_csv
from ship_bags.topic_names import add_bag_name_options
from ship_estimation.kalman.kalman_filter import StateModel
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import direction_change
from ship_geometry.mount.line_of_sight import covariance_by_source
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi, wrap_two_pi
from ship_node.messages.inputs_outputs import OutputMessage
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.outputs import NullSink
from ship_replay.offline.replay import match_inputs
from ship_replay.offline.replay_run import process_records
from ship_studies.axis_fit.sightings import (
    COLUMNS,
    LABEL_COLUMN,
    MAX_SIGHTINGS,
    TIME_COLUMN,
    correlated_column,
    right_and_up,
)
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.filter.prediction import Prediction
from theodolite_calib.filter.telescope_attitude import linearise, solve_attitude, total_covariance
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.samples.samples import Exposure, ExposureDecision, PointingOutcome
from theodolite_calib.samples.sighting import Sighting

# The axis errors are the unknowns of the fit, not errors of a sighting.
_FITTED_BLOCK = "axes"
_SHIP = "ship.attitude"
_LEAST_LIGHTS = 2
# Errors whose effects are all below this (arcsec) are omitted.
_LEAST_EFFECT_ARCSEC = 0.01


def correlated_effects(
    model: StateModel, prediction: Prediction, sighting: Sighting, rotation_nt: FloatArray, direction_d: FloatArray
) -> dict[tuple[str, float], FloatArray]:
    """Return the effect of one sigma of each correlated error on a sighting.

    Args:
        model: model of the errors.
        prediction: exposure predicted with the configured values, with its Jacobian with respect to all errors.
        sighting: the exposure.
        rotation_nt: attitude of the telescope (horizon from telescope) from the beacons, shape (3, 3).
        direction_d: direction of the main axis by this attitude, unit vector in d, shape (3,).

    Returns:
        Name and correlation time (s) → angles to the right and up, shape (2,), rad.
    """
    line_covariance = total_covariance(covariance_by_source(prediction.lines.terms))
    equations = linearise(
        sighting.image, prediction.camera, prediction.lines.direction_n, line_covariance, rotation_nt, None
    )
    gain = np.linalg.solve(equations.weighted_jacobian @ equations.jacobian, equations.weighted_jacobian)
    # The beacons give the telescope's attitude without the axis geometry, whose part is removed from the Jacobian.
    through_beacons = gain @ (prediction.jacobian - prediction.by_attitude_n @ prediction.by_state_n)
    turn_d = sighting.ship.rotation_nd.T @ (prediction.by_state_n + through_beacons)
    by_error = right_and_up(direction_d) @ direction_change(direction_d, turn_d)
    effects = {}
    for name, block in model.blocks.items():
        if name == _FITTED_BLOCK:
            continue
        root = np.diag(block.sigma)
        if name == _SHIP and sighting.ship.correlated_covariance_n is not None:
            values, vectors = np.linalg.eigh(sighting.ship.correlated_covariance_n)
            root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        effect = by_error[:, model.slices[name]] @ root
        for number, time_s in enumerate(block.time_s):
            effects[f"{name}.{number + 1}", float(time_s)] = effect[:, number]
    return effects


@dataclass(frozen=True)
class AxisSighting:
    """Sighting of one exposure, which is one row of the table.

    Attributes:
        angles_deg: encoder azimuth, encoder elevation, offsets of the true direction from these two angles.
        correlated_effects: name and correlation time (s) of a correlated error → effect of one sigma on the sighting,
            right and up, shape (2,), rad.
    """

    angles_deg: tuple[float, float, float, float]
    correlated_effects: dict[tuple[str, float], FloatArray]


@dataclass
class AxisSightings:
    """Table of sightings.

    Attributes:
        rows: sightings by stamp, ns.
        unused_count: number of exposures of lights that gave no sighting.
    """

    rows: dict[int, AxisSighting] = field(default_factory=dict)
    unused_count: int = 0

    @property
    def selected_stamps(self) -> list[int]:
        """Stamps of the rows to write, in order; an even selection if there are more rows than ``MAX_SIGHTINGS``."""
        stamps = sorted(self.rows)
        if len(stamps) <= MAX_SIGHTINGS:
            return stamps
        return [stamps[i] for i in np.linspace(0, len(stamps) - 1, MAX_SIGHTINGS).round().astype(int)]

    def write(self, path: Path) -> None:
        """Write the selected rows as CSV, in order of time, without correlated errors of negligible effect."""
        stamps = self.selected_stamps
        keys = dict.fromkeys(key for row in self.rows.values() for key in row.correlated_effects)
        correlated_errors = [key for key in keys if self._has_effect(key, stamps)]
        names = [correlated_column(side, *key) for key in correlated_errors for side in (0, 1)]
        # Angles in degrees and times need more decimals than a table in arcseconds.
        write_csv(
            path,
            [LABEL_COLUMN, TIME_COLUMN, *COLUMNS, *names],
            (
                (number, f"{stamp // 10**9}.{stamp % 10**9:09d}", *self._cells(self.rows[stamp], correlated_errors))
                for number, stamp in enumerate(stamps, start=1)
            ),
        )

    def add_decision(self, core: OpticalAxisCore, decision: ExposureDecision) -> None:
        """Add the sighting of an exposure of lights; count the exposure as unused if there is no sighting."""
        exposure = decision.measurement
        if not isinstance(exposure, Exposure):
            return  # stars, or a target
        time_ns = exposure.time_ns
        self.rows.pop(time_ns, None)
        row = _sighting(core, exposure, decision)
        if row is None:
            self.unused_count += 1
        else:
            self.rows[time_ns] = row

    def _has_effect(self, key: tuple[str, float], stamps: list[int]) -> bool:
        effects = [
            self.rows[stamp].correlated_effects[key] for stamp in stamps if key in self.rows[stamp].correlated_effects
        ]
        return bool(np.max(np.abs(effects)) > _LEAST_EFFECT_ARCSEC * ARCSEC)

    @staticmethod
    def _cells(row: AxisSighting, correlated_errors: list[tuple[str, float]]) -> list[str]:
        none = np.zeros(2)
        effects = [value / ARCSEC + 0.0 for key in correlated_errors for value in row.correlated_effects.get(key, none)]
        return [*(f"{value:.8f}" for value in row.angles_deg), *(f"{value:.4f}" for value in effects)]


def axis_sightings(
    bag_path: Path,
    config_path: Path | None = None,
    namespace: str = "",
    progress: ProgressWrapper = lambda records, bag: records,
) -> AxisSightings:
    """Return the sightings of a bag.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        config_path: suite configuration; None for the configuration attached to the bag.
        namespace: namespace of the ship in the bag.
        progress: function that wraps the iteration over the bag in a progress bar.

    Raises:
        BadInput: the bag or the configuration cannot be used, or no exposure of two lights was used.
    """
    found = AxisSightings()

    class DecisionRecorder(OpticalAxisAdapter):
        def report_outcome(self, outcome: PointingOutcome, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
            for decision in outcome.decisions:
                found.add_decision(self.core, decision)
            return super().report_outcome(outcome, now_ns, waiting_ns)

    with read_bag(bag_path) as bag:
        chain, _ = suite_chain(bag, (DecisionRecorder,), RosbagsFactory(), config_path, namespace)
        names = match_inputs(bag, chain, namespace)
        process_records(chain, progress(bag.records(names), bag), names, NullSink())
    if not found.rows:
        others = f"{found.unused_count} others"
        raise BadInput(f"no exposure of two lights was used ({others}): axes cannot be fitted", file=bag_path)
    return found


def _sighting(core: OpticalAxisCore, exposure: Exposure, decision: ExposureDecision) -> AxisSighting | None:
    """Return the sighting of an exposure; None unless all lights, at least two, were used and give an attitude."""
    sighting = core.streams.sightings.assemble(exposure).sighting
    usable = decision.accepted and decision.reason is Reason.NONE and not decision.rejected_parts
    if isinstance(sighting, Rejection) or not usable or len(sighting.names) < _LEAST_LIGHTS:
        return None
    # Camera and lines of sight are those of the configuration: estimates of the filter must not enter a sighting.
    filter_, telescope = core.filter, core.config.telescope
    prediction = filter_.sightings.predict(np.zeros(filter_.model.size), sighting)
    attitude = solve_attitude(sighting.image, prediction.camera, prediction.lines)
    if not attitude.solved:
        return None
    rotation_tm = rotation_from_angles(*telescope.parallelism)
    direction_d = sighting.deck_from_telescope(attitude.rotation_nt) @ rotation_tm[:, 0]
    bow, up, starboard = direction_d
    azimuth, elevation = np.arctan2(starboard, bow), np.arctan2(up, np.hypot(bow, starboard))
    encoder = sighting.encoder
    angles_deg = (
        float(np.rad2deg(wrap_two_pi(encoder.azimuth))),
        float(np.rad2deg(encoder.elevation)),
        float(np.rad2deg(wrap_pi(azimuth - encoder.azimuth))),
        float(np.rad2deg(elevation - encoder.elevation)),
    )
    return AxisSighting(
        angles_deg, correlated_effects(filter_.model, prediction, sighting, attitude.rotation_nt, direction_d)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="axis_sightings",
        example="bags/theodolite.mcap --out sightings.csv",
        epilog="exit code: 0 written; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description="Write the sightings of a bag as a table for fit_axes. Each exposure with two lights or more that "
        "the node optical_axis used is one row: encoder angles [deg], true direction of the main axis on deck minus "
        "these [deg], time [s], and the effect of one sigma of each correlated error (deformation, ship, baselines, "
        "levers, refraction) [arcsec].",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument("--out", type=Path, required=True, metavar="SIGHTINGS.csv", help="table to write")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    add_bag_name_options(parser)
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.out.suffix.lower() != ".csv":
        raise BadInput("fit_axes reads .csv: use this extension", file=options.out)
    check_file(options.out, options.force)
    sightings = axis_sightings(options.bag, options.config, options.namespace, progress=with_bag_progress)
    sightings.write(options.out)
    count, written = len(sightings.rows), len(sightings.selected_stamps)
    spread = "" if written == count else f" ({written} of them written, evenly spread: the most that fit_axes reads)"
    sys.stdout.write(f"{options.out}: {count} sightings{spread}, {sightings.unused_count} exposures not used\n")
    return EXIT_DONE
