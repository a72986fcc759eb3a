"""Sightings of lights in a bag as the table that ``fit_axes`` reads: encoder angles, and where the axis really looked.

The bag goes through the node ``optical_axis``, which judges every exposure. Of those with two lights or more that it
used, the lights alone say how the telescope stood in the deck, and the configured parallelism brings that to the main
axis.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ship_estimation.refusals import Reason
from ship_geometry.rotations import wrap_pi, wrap_two_pi
from ship_node.csv_table import write_csv
from ship_node.topics import Published
from ship_replay.adapter_chain import suite_chain
from ship_replay.bag_reader import read_bag
from ship_replay.errors import BadInput
from ship_replay.message_store import RosbagsFactory
from ship_replay.replay import Watcher, match_inputs
from ship_replay.replay_run import ReplayRun, ReplaySummary
from theodolite_calib.adapter import OpticalAxisAdapter
from theodolite_calib.axis_fit.sighting_file import COLUMNS, LABEL_COLUMN
from theodolite_calib.parallelism import Parallelism
from theodolite_calib.pointing import solve
from theodolite_calib.samples import Decision, Outcome

_LEAST_LIGHTS = 2


@dataclass
class _Sink:
    """Takes what the node publishes: only its judgements are wanted."""

    count: int = 0

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take a message."""
        self.count += 1

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Take a message given by its bytes."""


@dataclass
class AxisSightings:
    """The table.

    Attributes:
        rows: stamp (ns) → encoder azimuth, encoder elevation, offsets of the true direction from them, degrees.
        unused: exposures that were refused, or showed a single light.
    """

    rows: dict[int, tuple[float, float, float, float]] = field(default_factory=dict)
    unused: int = 0

    def write(self, path: Path) -> None:
        """As CSV, in order of time."""
        rows = ((number, *self.rows[stamp]) for number, stamp in enumerate(sorted(self.rows), start=1))
        # Angles in degrees want more decimals than a table in arcseconds.
        write_csv(path, [LABEL_COLUMN, *COLUMNS], ((n, *(f"{value:.8f}" for value in row)) for n, *row in rows))


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
        def _published(self, outcome: Outcome, now_ns: int) -> list[Published]:
            for decision in outcome.decisions:
                _take(found, self, decision)
            return super()._published(outcome, now_ns)

    with read_bag(bag_path) as bag:
        chain, _ = suite_chain(bag, (Listening,), RosbagsFactory(), config_path, namespace)
        names = {name: relative for relative, name in match_inputs(bag, chain, namespace).items()}
        run = ReplayRun(chain, _Sink(), ReplaySummary(), ())
        for record in watch(bag.records(names), bag):
            run.take(names[record.topic], record)
    if not found.rows:
        others = f"{found.unused} others"
        raise BadInput(f"{bag_path}: no exposure of two lights was used ({others}): nothing to fit axes by")
    return found


def _take(found: AxisSightings, adapter: OpticalAxisAdapter, decision: Decision) -> None:
    """Keep what the lights of an exposure say, where the node used them all as they are named."""
    time_ns = decision.exposure.time_ns
    found.rows.pop(time_ns, None)
    sighting = adapter.core.sighting(decision.exposure)
    usable = decision.accepted and decision.reason is Reason.NONE and not decision.lights_refused
    if sighting is None or not usable or len(sighting.names) < _LEAST_LIGHTS:
        found.unused += 1
        return
    # The camera and the lines of sight as configured: nothing that the filter has learnt may come back as a sighting.
    filter_, telescope = adapter.core.filter, adapter.core.config.telescope
    prediction = filter_.sightings.predict(np.zeros(filter_.model.size), sighting)
    pointing = solve(sighting.image, prediction.camera, prediction.lines)
    if not pointing.solved:
        found.unused += 1
        return
    parallelism = Parallelism(telescope.parallelism, np.zeros((3, 3)))
    bow, up, starboard = sighting.in_deck(pointing.rotation_nt) @ parallelism.rotation_tm[:, 0]
    azimuth, elevation = np.arctan2(starboard, bow), np.arctan2(up, np.hypot(bow, starboard))
    encoder = sighting.encoder
    found.rows[time_ns] = (
        float(np.rad2deg(wrap_two_pi(encoder.azimuth))),
        float(np.rad2deg(encoder.elevation)),
        float(np.rad2deg(wrap_pi(azimuth - encoder.azimuth))),
        float(np.rad2deg(elevation - encoder.elevation)),
    )
