"""Sightings of lights in a bag as the table that ``fit_axes`` reads: encoder angles, and where the axis really looked.

The bag goes through the node ``optical_axis``, which judges every exposure. Of those with two lights or more that it
used, the lights alone say how the telescope stood in the deck, and the configured parallelism brings that to the main
axis. What lasts from exposure to exposure - the deck's deformation, the ship's error, errors of baselines, levers and
refraction - is in the offsets, so the table says what each such error may do to each sighting.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.output_files import write_csv
from ship_estimation.refusals import Reason
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi, wrap_two_pi
from ship_node.edge.topics import Published
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import Watcher, match_inputs
from ship_replay.offline.replay_run import ReplayRun, ReplaySummary
from theodolite_calib.axis_fit.exposure_errors import slow_effects
from theodolite_calib.axis_fit.sighting_file import COLUMNS, LABEL_COLUMN, TIME_COLUMN, slow_column
from theodolite_calib.axis_fit.sightings import MOST_SIGHTINGS
from theodolite_calib.lights.telescope_attitude import solve
from theodolite_calib.measured.samples import Exposure, ExposureDecision, PointingOutcome
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.ros.optical_axis_adapter import OpticalAxisAdapter

_LEAST_LIGHTS = 2
# Below this (arcsec) everywhere an error is none.
_LEAST_EFFECT_ARCSEC = 0.01


class _Sink:
    """Takes what the node publishes and keeps nothing of it: only the judgements of the node are wanted."""

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Pass over a message."""

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Pass over the truth."""


@dataclass(frozen=True)
class AxisSighting:
    """What one exposure says of the axes: one row of the table.

    Attributes:
        angles_deg: encoder azimuth, encoder elevation, offsets of the true direction from them.
        slow: name and correlation time (s) of an error that lasts → what one sigma of it moves the sighting by, to the
            right and up, shape (2,), rad.
    """

    angles_deg: tuple[float, float, float, float]
    slow: dict[tuple[str, float], FloatArray]


@dataclass
class AxisSightings:
    """The table of sightings.

    Attributes:
        rows: by stamp, ns.
        unused: exposures that were refused, or showed a single light.
    """

    rows: dict[int, AxisSighting] = field(default_factory=dict)
    unused: int = 0

    @property
    def chosen(self) -> list[int]:
        """Stamps of the rows that are written, in order: all, or as many as a fit takes, evenly spread."""
        stamps = sorted(self.rows)
        if len(stamps) <= MOST_SIGHTINGS:
            return stamps
        return [stamps[i] for i in np.linspace(0, len(stamps) - 1, MOST_SIGHTINGS).round().astype(int)]

    def write(self, path: Path) -> None:
        """Write the table as CSV, in order of time."""
        chosen = self.chosen
        slow = [key for key in self._slow_errors() if self._moves(key, chosen)]
        names = [slow_column(side, *key) for key in slow for side in (0, 1)]
        # Angles in degrees want more decimals than a table in arcseconds; so does the time.
        write_csv(
            path,
            [LABEL_COLUMN, TIME_COLUMN, *COLUMNS, *names],
            (
                (number, f"{stamp // 10**9}.{stamp % 10**9:09d}", *self._cells(self.rows[stamp], slow))
                for number, stamp in enumerate(chosen, start=1)
            ),
        )

    def take(self, core: OpticalAxisCore, decision: ExposureDecision) -> None:
        """Keep what the lights of an exposure say, where the core used them all as they are named."""
        exposure = decision.measurement
        if not isinstance(exposure, Exposure):
            return  # stars, or a target
        time_ns = exposure.time_ns
        self.rows.pop(time_ns, None)
        row = _row(core, exposure, decision)
        if row is None:
            self.unused += 1
        else:
            self.rows[time_ns] = row

    def _slow_errors(self) -> list[tuple[str, float]]:
        return list(dict.fromkeys(key for row in self.rows.values() for key in row.slow))

    def _moves(self, key: tuple[str, float], chosen: list[int]) -> bool:
        effects = [self.rows[stamp].slow[key] for stamp in chosen if key in self.rows[stamp].slow]
        return bool(np.max(np.abs(effects)) > _LEAST_EFFECT_ARCSEC * ARCSEC)

    @staticmethod
    def _cells(row: AxisSighting, slow: list[tuple[str, float]]) -> list[str]:
        none = np.zeros(2)
        effects = [value / ARCSEC + 0.0 for key in slow for value in row.slow.get(key, none)]
        return [*(f"{value:.8f}" for value in row.angles_deg), *(f"{value:.4f}" for value in effects)]


def axis_sightings(
    bag_path: Path,
    config_path: Path | None = None,
    namespace: str = "",
    watch: Watcher = lambda records, bag: records,
) -> AxisSightings:
    """The sightings of a bag.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        watch: wraps the iteration over the bag, for a progress bar.

    Raises:
        BadInput: the bag or the configuration does not serve, or no exposure of two lights was used.
    """
    found = AxisSightings()

    class Listening(OpticalAxisAdapter):
        def published(self, outcome: PointingOutcome, now_ns: int, waiting_ns: int) -> list[Published]:
            for decision in outcome.decisions:
                found.take(self.core, decision)
            return super().published(outcome, now_ns, waiting_ns)

    with read_bag(bag_path) as bag:
        chain, _ = suite_chain(bag, (Listening,), RosbagsFactory(), config_path, namespace)
        names = {name: relative for relative, name in match_inputs(bag, chain, namespace).items()}
        run = ReplayRun(chain, _Sink(), ReplaySummary(), ())
        for record in watch(bag.records(names), bag):
            run.take(names[record.topic], record)
    if not found.rows:
        others = f"{found.unused} others"
        raise BadInput(f"no exposure of two lights was used ({others}): nothing to fit axes by", file=bag_path)
    return found


def _row(core: OpticalAxisCore, exposure: Exposure, decision: ExposureDecision) -> AxisSighting | None:
    """What the lights of an exposure say; None where they were not all used, or are too few."""
    sighting = core.sighting(exposure)
    usable = decision.accepted and decision.reason is Reason.NONE and not decision.left_out
    if sighting is None or not usable or len(sighting.names) < _LEAST_LIGHTS:
        return None
    # The camera and the lines of sight as configured: nothing that the filter has learnt may come back as a sighting.
    filter_, telescope = core.filter, core.config.telescope
    prediction = filter_.sightings.predict(np.zeros(filter_.model.size), sighting)
    attitude = solve(sighting.image, prediction.camera, prediction.lines)
    if not attitude.solved:
        return None
    rotation_tm = rotation_from_angles(*telescope.parallelism)
    direction_d = sighting.in_deck(attitude.rotation_nt) @ rotation_tm[:, 0]
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
        angles_deg, slow_effects(filter_.model, prediction, sighting, attitude.rotation_nt, direction_d)
    )
