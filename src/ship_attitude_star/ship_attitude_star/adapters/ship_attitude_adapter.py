"""Adapter of the node ``ship_attitude``: input topics, output messages and diagnostics."""

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from ship_attitude_star.adapters.alignment_file import ALIGNMENT_FILE
from ship_attitude_star.messages.attitude_messages import (
    ATTITUDE_TOPIC,
    ATTITUDE_TYPE,
    DEFLECTION_TOPIC,
    DEFLECTION_TYPE,
    DEGREES_TOPIC,
    DEGREES_TYPE,
    IMU_TOPIC,
    IMU_TYPE,
    SMOOTHED_TOPIC,
    AttitudeNumbers,
    alignment_state,
    attitude_budget,
    attitude_messages,
    attitude_rows,
    deflection_message,
    error_arcsec,
    installed_frames,
    smoothed_message,
    star_frames,
)
from ship_attitude_star.messages.input_messages import deflection, sensor_feeds
from ship_attitude_star.ship_attitude.alignment import (
    AlignmentPrior,
    current_alignment,
    installation_rotation,
)
from ship_attitude_star.ship_attitude.attitude_output import invalid_estimate
from ship_attitude_star.ship_attitude.config import InsConfig, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.corrected_ins import QUANTITIES
from ship_attitude_star.ship_attitude.observability import RecommendedTurn, observability_of, recommended_manoeuvre
from ship_attitude_star.smoothing import SmoothingCore
from ship_attitude_star.vertical.deflection import TOPIC
from ship_bags.cdr_template import CdrRows
from ship_bags.message_factory import MessageFactory
from ship_estimation.plausibility.integrated_rates import RateStatus
from ship_estimation.recovery.displacement import TOGETHER
from ship_estimation.rejection_rules import failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.adapters.adapter import BlockFeed, Feed, ignore_time
from ship_node.adapters.adapter_report import clock_status
from ship_node.adapters.node_adapter import OWN_OUTPUTS
from ship_node.adapters.recovering_adapter import RecoveringAdapter, recovery_counts, recovery_status
from ship_node.health.duplicate_publishers import ATTITUDE
from ship_node.messages.common_messages import (
    BUDGET_TYPE,
    INNOVATION_TYPE,
    INTEGRITY_TYPE,
    TF_STATIC_TOPIC,
    TF_TOPIC,
    TF_TYPE,
    DiagnosticStatus,
    Level,
)
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.inputs_outputs import InputTopic, OutputMessage, OutputRows, OutputTopic, ReadBlock
from ship_node.messages.sensor_readers import ins_block, ins_sample, sigma_mismatch_text
from ship_node.saved_files.saved_document import DISK, Files
from ship_node.saved_files.saved_start import SavedStart
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeSeries
from ship_stars.messages.surroundings_messages import surroundings_feeds
from ship_stars.sky.sky_model import SkyModel, load_sky_model

INTEGRITY_TOPIC = "ship/integrity"

_STATUS_TEXTS = {
    Status.VALID: (Level.OK, "VALID: INS and stars"),
    Status.COASTING: (Level.WARN, "COASTING: no star measurements, INS alone with growing uncertainty"),
    Status.DEGRADED: (Level.WARN, "DEGRADED"),
    Status.INVALID: (Level.ERROR, "INVALID: neither the INS nor stars give an attitude"),
}
_RATE_TEXTS = {
    RateStatus.UNPROVEN: (Level.OK, "not checked yet: too little motion, or no rates in the messages"),
    RateStatus.MEASURED: (Level.OK, "angular_velocity is consistent with the orientation"),
    RateStatus.NOT_MEASURED: (
        Level.WARN,
        "angular_velocity is not consistent with the orientation: not used (zero, noise, other axes, another unit?)",
    ),
    RateStatus.WRONG_UNITS: (Level.ERROR, "angular_velocity is in another unit than rad/s: the INS is not used"),
}
_OBSERVABILITY_PERIOD_NS = 60 * SECOND_NS
"""Period of the observability diagnostics, in the time of the data, ns."""


class ShipAttitudeAdapter(RecoveringAdapter):
    """Adapter of the ship attitude estimator.

    Args:
        config: parameters of the node.
        factory: creates messages.
        files: access to the alignment file.

    Raises:
        BadInput: the path of the alignment file or the computer's state does not allow a start (:class:`SavedStart`).
            A file with unusable content is only reported.
        ParameterError: the camera of a sensor that gives single stars is incomplete, or there are more filters than
            ``integrity.max_hypotheses``.
    """

    node_name: ClassVar[str] = "ship_attitude"
    config_type: ClassVar[type] = ShipAttitudeConfig
    services: ClassVar[tuple[str, ...]] = ("reset", "save_alignment", "load_alignment")
    main_topic: ClassVar[str] = ATTITUDE_TOPIC
    innovation_topic: ClassVar[str] = "ship/innovation"
    integrity_topic: ClassVar[str] = INTEGRITY_TOPIC
    quantities: ClassVar[tuple[str, ...]] = QUANTITIES
    required_sources: ClassVar[tuple[str, ...]] = ("ins",)
    redundancy_key: ClassVar["attrgetter[tuple[Any, ...]]"] = attrgetter("status", "sources")
    directions: ClassVar["attrgetter[np.ndarray]"] = attrgetter("rotation_nd")
    outputs: tuple[OutputTopic, ...] = (
        OutputTopic(ATTITUDE_TOPIC, ATTITUDE_TYPE),
        OutputTopic(IMU_TOPIC, IMU_TYPE),
        OutputTopic(DEGREES_TOPIC, DEGREES_TYPE),
        OutputTopic(TF_TOPIC, TF_TYPE),
        OutputTopic(TF_STATIC_TOPIC, TF_TYPE, latched=True),
        OutputTopic("ship/alignment", "ship_msgs/msg/AlignmentState"),
        OutputTopic("ship/error_budget", BUDGET_TYPE),
        OutputTopic(INTEGRITY_TOPIC, INTEGRITY_TYPE),
        OutputTopic(innovation_topic, INNOVATION_TYPE),
        OutputTopic("ship/error_arcsec", "ship_msgs/msg/AttitudeErrorArcsec"),
        OutputTopic(DEFLECTION_TOPIC, DEFLECTION_TYPE),
        OutputTopic(SMOOTHED_TOPIC, ATTITUDE_TYPE),
        *OWN_OUTPUTS,
    )

    def __init__(self, config: ShipAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
        looks_at_sky = any(star.needs_sky for star in config.star_sensors.values())
        self._sky_model = load_sky_model(config.sky) if looks_at_sky else None
        core = self.make_core(config, self._sky_model)
        saved = SavedStart(
            ALIGNMENT_FILE,
            config.alignment_file,
            files,
            start_from=self.start_from,
            content_to_save=self._alignment_to_save,
            nothing_text="no alignment to save: no star attitude was used yet",
        )
        self.start_warnings = self._missing_configuration = start_warnings(config)
        self._last_observability: tuple[int, DiagnosticStatus] | None = None
        self._stated_covariance: Any = None
        super().__init__(config, core, factory, self._attitude_messages, saved)
        self.integrity_frame = config.frames.deck
        self.outputs = tuple(output for output in self.outputs if output.type_name != TF_TYPE or config.publish_tf)

    def _alignment_to_save(self) -> AlignmentPrior | None:
        core: ShipAttitudeCore = self.core  # a second estimator may have replaced the first
        return core.alignment_to_save()

    def _attitude_messages(self, estimate: AttitudeEstimate) -> list[OutputMessage]:
        """Return the messages of one attitude."""
        config = self.config
        return attitude_messages(self.factory, estimate, self._rate_sigma, config.frames, config.publish_tf)

    @property
    def _rate_sigma(self) -> float:
        """Configured noise of the angular rate of the INS, each axis, rad/s."""
        return float(self.config.ins.rate_sigma_arcsec_per_s * ARCSEC)

    def make_core(self, config: ShipAttitudeConfig, sky_model: SkyModel | None) -> ShipAttitudeCore:
        """Return the estimator, with smoothing if configured."""
        if config.smoothing_lag_s:
            return SmoothingCore(config, sky_model, config.smoothing_lag_s)
        return ShipAttitudeCore(config, sky_model)

    @property
    def source_timeouts_s(self) -> Mapping[str, float]:
        """See :class:`RecoveringAdapter`."""
        return {"ins": 3.0, **dict.fromkeys(self.config.devices, 10.0)}

    def report_outcome(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`; smoothed attitudes follow."""
        published = super().report_outcome(outcome, now_ns, waiting_ns)
        if isinstance(self.core, SmoothingCore):
            try:
                smoothed = self._smoothed_messages(self.core.take_smoothed())
            except Exception as error:
                # Real-time attitudes are published in any case; smoothing restarts.
                self.core.restart_smoothing()
                smoothed = [self.report_failure(SMOOTHED_TOPIC, now_ns, failure_rejection(error))]
            published += smoothed
        return published

    def table(self, config: ShipAttitudeConfig, core: ShipAttitudeCore) -> Iterator[Feed]:
        """Yield the inputs and the methods of a core that process them."""
        ins = InputTopic("ins/imu", IMU_TYPE, required=True, depth=1000)
        block = None
        if not isinstance(core, SmoothingCore):  # smoothing needs single samples
            block = BlockFeed(functools.partial(self._read_ins_block, config=config.ins), core.ins)
        read_ins = functools.partial(self._read_ins, config=config.ins)
        yield Feed(ins, "ins", read_ins, core.ins.add, block=block, shows_present="ins", stream_quantity=ATTITUDE)
        yield from sensor_feeds(config, core, self._sky_model)
        if self._sky_model is not None:
            yield from surroundings_feeds(config.sky, ignore_time(core.add_surroundings))
        elif config.needs_vertical:
            yield from surroundings_feeds(config.sky, ignore_time(core.add_surroundings), topics=("gnss/fix",))
        if config.gravity.deflection == TOPIC:
            given = InputTopic("gravity/deflection", DEFLECTION_TYPE, False, depth=100, is_valid_until_next=True)
            yield Feed(given, "gravity/deflection", deflection, ignore_time(core.add_surroundings))

    def _read_ins(self, message: Any, receive_ns: int, config: InsConfig) -> ReadMessage[AttitudeSample]:
        """Return an INS sample; the covariance of its message is stored for the diagnostics."""
        reading = ins_sample(message, config, receive_ns)
        self._stated_covariance = message.orientation_covariance if reading.covariance_known else None
        return reading

    def _read_ins_block(self, messages: CdrRows, receive_ns: StampArray, config: InsConfig) -> ReadBlock:
        """Return the INS samples of a block; the covariance of the first message is stored for the diagnostics."""
        reading = ins_block(messages, receive_ns, config)
        self._stated_covariance = messages.message(0).orientation_covariance if reading.covariance_known else None
        return reading

    def batch_messages(self, runs: Sequence[AttitudeSeries]) -> Iterator[OutputRows]:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`."""
        attitudes, config = AttitudeNumbers.from_runs(runs), self.config
        return attitude_rows(self.factory, attitudes, self._rate_sigma, config.frames, config.publish_tf)

    def own_slow_topics(self, now_ns: int) -> list[OutputMessage]:
        """Return alignment and sensor frames; for a new attitude also error budget, sigmas and deflection."""
        factory, estimate, published = self.factory, self.pending_budget, []
        deck, horizon = self.config.frames.deck, self.config.frames.horizon
        if estimate is not None:
            sources = self.core.filter.model.sources
            published += [
                ("ship/error_budget", attitude_budget(factory, estimate, sources, deck)),
                ("ship/error_arcsec", error_arcsec(factory, estimate, deck)),
            ]
        frames = star_frames(self.config.star_sensors, {deck, horizon})
        filter_, state = self.core.filter, self.core.state
        installed = {frame: installation_rotation(filter_, state, f"star.{id_}") for id_, frame in frames.items()}
        if installed and self.config.publish_tf:
            published.append((TF_STATIC_TOPIC, installed_frames(factory, installed, now_ns, deck)))
        if estimate is not None and self.config.gravity.is_modelled:
            known = self.core.output.deflection(estimate.time_ns)
            published.append((DEFLECTION_TOPIC, deflection_message(factory, known, horizon)))
        alignment = current_alignment(filter_, self.config, state)
        return [*published, ("ship/alignment", alignment_state(factory, alignment, now_ns, deck))]

    def no_output(self, now_ns: int, text: str) -> AttitudeEstimate:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`."""
        core: ShipAttitudeCore = self.core
        return invalid_estimate(core.filter, core.state, now_ns, text)

    def can_be_valid(self, present_sources: Set[str]) -> bool:
        """See :class:`RecoveringAdapter`; True with the INS and a star sensor."""
        return "ins" in present_sources and any(source.startswith("star.") for source in present_sources)

    def remedy(self, displaced: Mapping[str, float]) -> str:
        """See :class:`RecoveringAdapter`."""
        if TOGETHER in displaced:
            return (
                "if the star sensors or the INS were remounted, call ~/reset; otherwise check the clocks "
                "(time_offset_s of each sensor and of ins), gnss/fix and the computer's clock"
            )
        devices = self.core.filter.devices
        where = ".time_offset_s, ".join(devices[name].parameters for name in sorted(displaced))
        return f"if remounted, call ~/reset; otherwise check clock and cable (parameters {where}.time_offset_s)"

    def before_adoption(self) -> list[OutputMessage]:
        """See :class:`RecoveringAdapter`; returns the remaining smoothed attitudes."""
        return self._smoothed_messages(self.core.smooth_remaining()) if isinstance(self.core, SmoothingCore) else []

    def _smoothed_messages(self, estimates: Iterable[AttitudeEstimate]) -> list[OutputMessage]:
        return [smoothed_message(self.factory, estimate, self.config.frames) for estimate in estimates]

    def _observability_statuses(self) -> list[DiagnosticStatus]:
        """Return the observability diagnostics with a recommended turn, computed once a minute; empty while INVALID."""
        state, latest = self.core.state, self.latest
        if state.time_ns is None or latest is None or latest.status is Status.INVALID:
            return []
        if (
            self._last_observability is None
            or abs(state.time_ns - self._last_observability[0]) >= _OBSERVABILITY_PERIOD_NS
        ):
            observability = observability_of(self.core.filter, self.config, state)
            # Without stars a turn does not improve the attitude.
            sources = self.core.recent_sources if latest.status is Status.VALID else {}
            turn = manoeuvre_text(recommended_manoeuvre(self.core.filter, state, latest.rotation_nd, sources))
            values = {f"{name} (sigma / before)": f"{left:.2f}" for name, left in observability.sigma_ratios.items()}
            values |= {
                "unobservable combinations": "; ".join(observability.unobservable_combinations) or "nothing",
                "turn": turn or "none recommended",
            }
            text = turn or "no turn of the ship improves the attitude much"
            self._last_observability = state.time_ns, DiagnosticStatus("observability", Level.OK, text, values)
        return [self._last_observability[1]]

    def _noise_status(self) -> DiagnosticStatus:
        """Return a diagnostic of INS message sigmas far above the configured sigmas, otherwise of excess INS noise."""
        if self._stated_covariance is not None:
            covariance = np.reshape(self._stated_covariance, (3, 3))
            if contradicted := sigma_mismatch_text(covariance, self.config.ins):
                text = f"{contradicted}: raise the parameter, or check the INS"
                return DiagnosticStatus("ins noise", Level.WARN, text)
        excess = self.core.ins.ins_check.comparison.excess_text
        if not excess:
            text = "not larger than ins.white_sigma_arcsec, as far as the ship's motion shows it"
            return DiagnosticStatus("ins noise", Level.OK, text)
        return DiagnosticStatus("ins noise", Level.WARN, f"ins/imu: {excess}; included in the covariances")

    def own_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return all diagnostics of this node, from attitude and alignment to innovations and clocks."""
        remarks, devices = self.saved_document_remarks(), self.core.filter.devices
        sections = {name.partition(".")[0]: one.parameters.partition(".")[0] for name, one in devices.items()}
        text = "; ".join(remarks) or "as configured or loaded"
        return [
            attitude_status(self.latest, self.clock_jumps, self._missing_configuration),
            DiagnosticStatus("alignment", Level.WARN if remarks else Level.OK, text, recovery_counts(self.recovery)),
            DiagnosticStatus("ins rates", *_RATE_TEXTS[self.core.ins.ins_check.rate_status]),
            self._noise_status(),
            recovery_status(self.recovery, self.core.excluded_sources, self.remedy, waiting_ns),
            *vertical_statuses(self.core, self.latest),
            *self._observability_statuses(),
            *self.integrity_statuses(),
            *self.conflict_statuses(),
            *self.innovation_report.statuses(),
            clock_status(self.core.filter.model, self.core.state.mean, sections),
        ]


def manoeuvre_text(turn: RecommendedTurn | None) -> str:
    """Return a text about a recommended turn; empty if no turn is recommended."""
    if turn is None:
        return ""
    now, on_course, after = (
        f'{sigma / ARCSEC:.1f}"' for sigma in (turn.sigma_now, turn.sigma_on_course, turn.sigma_after_turn)
    )
    turned = f"a turn by {turn.turn_deg:.0f}° improves the {turn.quantity}: σ {now} → {after} in a quarter of an hour"
    return f"{turned}, {on_course} on this course"


def vertical_statuses(core: ShipAttitudeCore, latest: AttitudeEstimate | None) -> list[DiagnosticStatus]:
    """Return a diagnostic of the vertical at the last attitude; empty without a vertical or while INVALID."""
    if core.vertical is None or latest is None or latest.status is Status.INVALID:
        return []
    known, missing = core.output.deflection(latest.time_ns), core.vertical.missing_data_text(latest.time_ns)
    if known is None:
        text = missing or "the latitude for the error model of the INS is known"
        return [DiagnosticStatus("vertical", Level.WARN if missing else Level.OK, text)]
    assert known.covariance is not None
    values_arcsec = [*known.deflection / ARCSEC, *np.sqrt(known.covariance.diagonal()) / ARCSEC]
    names = ("xi (arcsec)", "eta (arcsec)", "sigma of xi (arcsec)", "sigma of eta (arcsec)")
    values = {name: f"{value:.1f}" for name, value in zip(names, values_arcsec, strict=True)}
    text = missing or "the deflection of the vertical is known or estimated"
    return [DiagnosticStatus("vertical", Level.WARN if missing else Level.OK, text, values)]


def start_warnings(config: ShipAttitudeConfig) -> tuple[str, ...]:
    """Return texts about missing parts of a configuration, for the log at the start and the diagnostics."""
    if config.devices:
        return ()
    lacking = "no star_sensors, no references and no ship_baseline are configured"
    return (f"{lacking}: the attitude is that of the INS alone, DEGRADED, horizon GRAVITY",)


def attitude_status(
    estimate: AttitudeEstimate | None, clock_jumps: int, missing_configuration: Sequence[str] = ()
) -> DiagnosticStatus:
    """Return the diagnostic of the published attitude.

    Args:
        estimate: last attitude.
        clock_jumps: number of backward jumps of the clock.
        missing_configuration: missing parts of the configuration (:func:`start_warnings`).
    """
    values = {"clock jumps back": str(clock_jumps)}
    if estimate is None:
        text = "; ".join(["no INS sample yet", *missing_configuration])
        return DiagnosticStatus("attitude", Level.WARN, text, values)
    level, text = _STATUS_TEXTS[estimate.status]
    if estimate.status is Status.DEGRADED and missing_configuration and "ins" in estimate.sources:
        text += f": {'; '.join(missing_configuration)}"
    elif estimate.status is Status.DEGRADED:
        text += f": {estimate.text}"
    elif estimate.status is Status.INVALID and estimate.text:
        text = f"INVALID: {estimate.text}"
    values |= {"sources": ", ".join(estimate.sources), "star age (s)": f"{estimate.star_age_s:.1f}"}
    return DiagnosticStatus("attitude", level, text, values)
