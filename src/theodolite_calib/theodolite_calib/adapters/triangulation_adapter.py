"""Adapter of the node ``triangulation``: input topics of the theodolites, position messages and diagnostics."""

import functools
import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_estimation.time_order.outcome import Status
from ship_node.adapters.adapter import Feed
from ship_node.adapters.node_adapter import OWN_OUTPUTS, NodeAdapter
from ship_node.messages.common_messages import INNOVATION_TYPE, DiagnosticStatus, Level, rejection_message
from ship_node.messages.inputs_outputs import InputTopic, OutputMessage, OutputTopic
from ship_node.saved_files.saved_document import DISK, Files
from theodolite_calib.messages.input_messages import direction
from theodolite_calib.messages.output_messages import TARGET_TYPE, target_message
from theodolite_calib.samples.samples import TargetEstimate
from theodolite_calib.triangulation.triangulation import TriangulationConfig
from theodolite_calib.triangulation.triangulation_core import PositionEstimate, TriangulationCore, TriangulationOutcome

POSITION_TOPIC, INNOVATION_TOPIC = "target/position", "target/innovation"
ORIGIN_FRAME = "triangulation_origin"

_STALE_NS = 10_000_000_000
"""Maximum age of a position that is reported as current, ns."""


class TriangulationAdapter(NodeAdapter):
    """Positions of targets from the directions of several theodolites.

    Args:
        config: parameters of the node.
        factory: creates the messages.
        files: unused.
    """

    node_name: ClassVar[str] = "triangulation"
    config_type: ClassVar[type] = TriangulationConfig
    services: ClassVar[tuple[str, ...]] = ("reset",)
    main_topic: ClassVar[str] = POSITION_TOPIC
    innovation_topic: ClassVar[str] = INNOVATION_TOPIC
    reset_text: ClassVar[str] = "all directions are discarded"
    outputs: tuple[OutputTopic, ...] = (
        OutputTopic(POSITION_TOPIC, TARGET_TYPE),
        OutputTopic(INNOVATION_TOPIC, INNOVATION_TYPE),
        *OWN_OUTPUTS,
    )

    def __init__(self, config: TriangulationConfig, factory: MessageFactory, files: Files = DISK) -> None:
        if len(config.stations) < 2:
            self.start_warnings = (f"stations has {len(config.stations)}: a position needs two theodolites or more",)
        self._published_ns: int | None = None
        super().__init__(config, TriangulationCore(config), factory, functools.partial(position_messages, factory))

    def table(self, config: TriangulationConfig, core: TriangulationCore) -> Iterator[Feed]:
        """Yield the inputs with the core's methods that process them."""
        for name in sorted(config.stations):
            topic = InputTopic(config.topic_of(name), TARGET_TYPE, required=False, depth=100, is_occasional=True)
            read = functools.partial(direction, station=name, horizon=config.frames.horizon)
            yield Feed(topic, f"station.{name}", read, core.add_direction)

    def report_outcome(self, outcome: TriangulationOutcome, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """See :class:`NodeAdapter`; the positions of a node that is behind are not published."""
        if outcome.estimates and self.overload_report.behind is None:
            self._published_ns = waiting_ns
        return super().report_outcome(outcome, now_ns, waiting_ns)

    def own_slow_topics(self, now_ns: int) -> list[OutputMessage]:
        """Return no messages; a position has no error budget besides its covariance."""
        return []

    def own_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return the status of the last position."""
        values = {"clock jumps back": str(self.clock_jumps)}
        last: PositionEstimate | None = self.latest
        if last is None or self._published_ns is None:
            return [DiagnosticStatus("position", Level.OK, "no position yet", values)]
        if waiting_ns - self._published_ns > _STALE_NS:
            # The level is OK, because possibly no theodolite has a target in view.
            text = f"no position for {(waiting_ns - self._published_ns) * 1e-9:.0f} s, the last {last.status.name}"
            return [DiagnosticStatus("position", Level.OK, text, values)]
        values |= {"target": last.target_id, "theodolites": ", ".join(last.stations) or "none"}
        if last.status is not Status.INVALID:
            values["sigma in space (m)"] = f"{np.sqrt(np.trace(last.covariance_n)):.3g}"
        if last.triangulated is not None:
            values["chi-square"] = f"{last.triangulated.chi_square:.2f} of {last.triangulated.gate:.2f} at most"
        text = f"{last.status.name}: {last.text or 'by ' + ', '.join(last.stations)}"
        level = Level.OK if last.status is Status.VALID else Level.WARN
        return [DiagnosticStatus("position", level, text, values)]


def position_messages(factory: MessageFactory, estimate: PositionEstimate) -> list[OutputMessage]:
    """Return ship_msgs/TargetDirection with a position and NaN as direction, and a message of a rejection, if any."""
    target = TargetEstimate(
        estimate.time_ns,
        estimate.target_id,
        estimate.status,
        estimate.text,
        position_n=estimate.position_n,
        position_covariance_n=estimate.covariance_n,
    )
    published: list[OutputMessage] = [(POSITION_TOPIC, target_message(factory, target, ORIGIN_FRAME))]
    if estimate.rejection is not None:
        nis = math.nan if estimate.triangulated is None else estimate.triangulated.chi_square
        rejected = rejection_message(factory, "stations", estimate.time_ns, estimate.rejection, nis=nis)
        published.append((INNOVATION_TOPIC, rejected))
    return published
