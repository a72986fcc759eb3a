"""Sightings of lights in a bag as the table that ``fit_axes`` reads: encoder angles and true directions of the axis.

The node ``optical_axis`` processes the bag and accepts or rejects every exposure. For each exposure with two lights or
more that are all accepted, the attitude of the telescope is computed from the lights alone. The ship's attitude
transforms the telescope's attitude to the deck. The main axis follows with the configured parallelism. The offsets of
the true direction from the encoder angles contain correlated errors: the deck's deformation, the ship's error, errors
of baselines, levers and refraction. The table therefore lists the effect of each such error on each sighting.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.output_files import write_csv
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi, wrap_two_pi
from ship_node.messages.topics import OutputMessage
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import ProgressWrapper, match_inputs
from ship_replay.offline.replay_run import ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary
from ship_replay.offline.sinks import NullSink
from ship_studies.axis_fit.exposure_errors import correlated_effects
from ship_studies.axis_fit.sighting_file import COLUMNS, LABEL_COLUMN, TIME_COLUMN, correlated_column
from ship_studies.axis_fit.sightings import MAX_SIGHTINGS
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.beacon_camera.telescope_attitude import solve_attitude
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.samples.samples import Exposure, ExposureDecision, PointingOutcome

_LEAST_LIGHTS = 2
# Errors whose effects are all below this (arcsec) are omitted.
_LEAST_EFFECT_ARCSEC = 0.01


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
        correlated_errors = [key for key in self._correlated_errors() if self._has_effect(key, stamps)]
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

    def _correlated_errors(self) -> list[tuple[str, float]]:
        return list(dict.fromkeys(key for row in self.rows.values() for key in row.correlated_effects))

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
        names = {name: relative for relative, name in match_inputs(bag, chain, namespace).items()}
        run = ReplayRun(chain, NullSink(), ReplaySummary(), ())
        for record in progress(bag.records(names), bag):
            run.process_message(names[record.topic], record)
        run.finish()
    if not found.rows:
        others = f"{found.unused_count} others"
        raise BadInput(f"no exposure of two lights was used ({others}): axes cannot be fitted", file=bag_path)
    return found


def _sighting(core: OpticalAxisCore, exposure: Exposure, decision: ExposureDecision) -> AxisSighting | None:
    """Return the sighting of an exposure; None unless all lights, at least two, were used and give an attitude."""
    sighting = core.streams.sightings.assemble(exposure).sighting
    usable = decision.accepted and decision.reason is Reason.NONE and not decision.rejected_parts
    if sighting is None or not usable or len(sighting.names) < _LEAST_LIGHTS:
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
