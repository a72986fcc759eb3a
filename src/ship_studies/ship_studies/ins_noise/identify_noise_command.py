"""``identify_noise``: parameters of the INS's error model for ``ship_attitude``, from a bag with stars.

The error model is selected by the likelihood of the record. The result is a parameter file of the suite, and text with
warnings.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file, write_atomically
from ship_bags.parameter_yaml import PARAMETERS_KEY, in_any_namespace
from ship_bags.topic_names import add_bag_name_options
from ship_estimation.parameters.ship_devices import GAUSS_MARKOV
from ship_studies.ins_noise.fit import FittedModel, OutageCheck, fit, outage_checks
from ship_studies.ins_noise.processes import candidate_models
from ship_studies.ins_noise.session import NoiseSession, mean_location, run_session
from ship_studies.ins_noise.star_record import StarRecord, star_record

TIMES_NEEDED = 200.0
"""Length of a record, in correlation times τ, needed for σ within 10 % and τ within 30 %."""

_LEAST_EPOCHS = 50
_CLEAR = 10.0
"""Difference of AIC for a clear selection (Burnham and Anderson 2002, §2.6)."""

_EXPECTED_REFUSED = 0.01
_VAGUE = 0.3
_HOUR_S = 3600.0

_SIGMAS = 3.290526731491891
"""Number of sigmas of a two-sided 99.9 % interval."""


@dataclass(frozen=True)
class Identification:
    """Result of an identification.

    Attributes:
        session: session that is evaluated.
        record: record of the session.
        fitted: fitted models, the best model first.
        outages: name of a model → checks of the model's predictions.
    """

    session: NoiseSession
    record: StarRecord
    fitted: list[FittedModel]
    outages: dict[str, list[OutageCheck]]

    @property
    def best(self) -> FittedModel:
        """The best model by Akaike's criterion."""
        return self.fitted[0]

    @property
    def model_choice(self) -> str:
        """Selected model and its criteria, as text."""
        first, *others = self.fitted
        if not others:
            return f"only {first.model.name} was tried"
        (other,) = others
        ahead = other.aic - first.aic
        how = "fits" if ahead >= _CLEAR else f"fits slightly better ({_CLEAR:g} in AIC would be clear)"
        return (
            f"{first.model.name} {how}: log likelihood {first.log_likelihood:.1f} with {len(first.values)} parameters "
            f"against {other.log_likelihood:.1f} with {len(other.values)} of {other.model.name}; AIC (2 p - 2 log L) "
            f"less by {ahead:.1f}"
        )

    @property
    def warnings(self) -> list[str]:
        """Limitations of the result, one line each."""
        return [
            *(line for fitted in self.fitted for line in self._inconsistent_predictions(fitted.model.name)),
            *self._short_record_warnings(),
            *self._input_warnings(),
            *self.session.problems,
        ]

    def _inconsistent_predictions(self, model: str) -> list[str]:
        """Return a warning about tilt, and a warning about heading, if prediction errors are too large for their sigma.

        Only ``gauss_markov`` and the best model are checked; a warning contains the worst horizon.
        """
        if model not in (GAUSS_MARKOV, self.best.model.name):
            return []
        lines = []
        for part in ("tilt", "heading"):
            wrong = [check for check in self.outages[model] if not check.parts[part].is_consistent]
            if wrong:
                worst = max(wrong, key=lambda check: check.parts[part].nees / check.parts[part].nees_limit)
                missed = worst.parts[part]
                had, sigma = missed.rms_arcsec, missed.sigma_arcsec
                text = (
                    f"the most likely parameters of {model} are inconsistent in an outage: {part} "
                    f"predicted over {worst.horizon_s:.0f} s, {worst.intervals} times: RMS error {had:.1f}″, "
                    f"{had / sigma:.1f} × its σ of "
                    f"{sigma:.1f}″ (mean NEES {missed.nees:.1f}, at most {missed.nees_limit:.1f} with 99.9 %)"
                )
                lines.append(text)
        return lines

    def _short_record_warnings(self) -> list[str]:
        """Return warnings for a record too short to separate sigma and time of a Gauss-Markov process."""
        fitted = next(found for found in self.fitted if found.model.name == GAUSS_MARKOV)
        suite_values = {what.name: fitted.suite_value(what) for what in fitted.model.suite_parameters}
        lines = []
        for axis in ("tilt", "heading"):
            (_, log_sigma), (time_s, log_time) = suite_values[f"{axis}_sigma_arcsec"], suite_values[f"{axis}_time_s"]
            times = self.record.duration_s / time_s
            if times < TIMES_NEEDED:
                lines.append(
                    f"gauss_markov, {axis}: {self.record.duration_s / _HOUR_S:.2g} h are {times:.2g} correlation times,"
                    f" too short to separate σ and τ (σ {uncertainty_text(log_sigma)}, "
                    f"τ {uncertainty_text(log_time)}); 10 % and 30 % need "
                    f"{TIMES_NEEDED:g} times, {TIMES_NEEDED * time_s / _HOUR_S:.0f} h; only 2σ²/τ is determined"
                )
        return lines

    def _input_warnings(self) -> list[str]:
        session, record, lines = self.session, self.record, []
        if len(self.fitted) == 1:
            lines.append("schuler was not tried: the latitude is unknown without position fixes")
        white, log_sigma = self.best.suite_value(self.best.model.suite_parameters[0])
        if not log_sigma <= _VAGUE:
            lines.append(
                f"the record does not determine white_sigma_arcsec ({white:.2g}″, "
                f"{uncertainty_text(log_sigma)}): the star "
                "sensors' own noise hides it, or their messages state too much noise"
            )
        used = len(session.comparisons)
        if session.rejected_count > _EXPECTED_REFUSED * (used + session.rejected_count):
            lines.append(
                f"{session.rejected_count} of {used + session.rejected_count} star measurements were not used: "
                "see replay --report"
            )
        if not session.config.gravity.is_modelled:
            lines.append("gravity.deflection is none: the deflection of the vertical is part of the error found")
        if record.epoch_step > 1:
            lines.append(f"one of every {record.epoch_step} epochs was used: these are enough")
        return lines


def uncertainty_text(log_sigma: float) -> str:
    """Return the uncertainty of a positive number as text, from the sigma of its logarithm."""
    if log_sigma <= _VAGUE:
        return f"± {100.0 * log_sigma:.0f} %"
    factor = math.exp(log_sigma)
    return f"within a factor of {factor:.1f}" if factor < 100.0 else "not determined"


def identify(session: NoiseSession) -> Identification:
    """Identify the INS's error model from a session.

    Raises:
        BadInput: the session is too short.
    """
    record = star_record(session)
    if len(record.times_s) < _LEAST_EPOCHS:
        text = f"{len(record.times_s)} epochs of stars: expected at least {_LEAST_EPOCHS}, better hours of them"
        raise BadInput(f"{session.name}: {text}")
    place = mean_location(session.comparisons)
    fitted = sorted(
        (fit(record, model) for model in candidate_models(session.config.ins, place)), key=lambda one: one.aic
    )
    outages = {one.model.name: outage_checks(record, one) for one in fitted}
    return Identification(session, record, fitted, outages)


def parameter_file_text(identification: Identification) -> str:
    """Return the best model as a ROS 2 parameter file, with the sigma of each value as comment."""
    best, session = identification.best, identification.session
    values: dict[str, tuple[str, str]] = {"model": (f'"{best.model.name}"', "")}
    for what in best.model.suite_parameters:
        value, log_sigma = best.suite_value(what)
        values[what.name] = _number(value), f"{_sigma_text(value, log_sigma)} [{what.unit}]"
    for name, value in best.model.configured_values.items():
        values[name] = _number(value), "as configured"
    head = [f"By identify_noise from {session.name}. {identification.model_choice}.", *identification.warnings]
    lines = [
        *(f"# {line}" for line in head),
        f"{in_any_namespace(ShipAttitudeAdapter.node_name)}:",
        f"  {PARAMETERS_KEY}:",
    ]
    return "\n".join([*lines, "    ins:", *_yaml_lines(values)]) + "\n"


def _yaml_lines(values: dict[str, tuple[str, str]]) -> Iterator[str]:
    """Yield the lines of the section ``ins``, with dotted names as sections at the end."""
    plain = {name: texts for name, texts in values.items() if "." not in name}
    yield from (_line(6, name, *texts) for name, texts in plain.items())
    dotted = {name: texts for name, texts in values.items() if "." in name}
    for section in dict.fromkeys(name.partition(".")[0] for name in dotted):
        yield f"      {section}:"
        yield from (_line(8, name.partition(".")[2], *texts) for name, texts in dotted.items())


def _line(indent: int, name: str, value: str, comment: str) -> str:
    line = f"{' ' * indent}{name}: {value}"
    return f"{line}  # {comment}" if comment else line


def _number(value: float) -> str:
    """Return a value with four digits, always a floating-point number for ROS."""
    return repr(float(f"{value:.4g}"))


def _sigma_text(value: float, log_sigma: float) -> str:
    """Return the sigma of a value as text; if the sigma is large, as a factor."""
    known = uncertainty_text(log_sigma)
    return f"± {value * log_sigma:.2g}, 1 sigma" if known.startswith("±") else f"{known}, 1 sigma"


def result_lines(identification: Identification) -> list[str]:
    """Return the result line by line, without the warnings."""
    session, record = identification.session, identification.record
    hours, epochs = record.duration_s / 3600.0, len(record.times_s)
    lines = [f"{session.name}: {len(session.comparisons)} star measurements, {epochs} epochs used over {hours:.2f} h"]
    for fitted in identification.fitted:
        name = fitted.model.name
        lines.append(f"{name}: log likelihood {fitted.log_likelihood:.1f}, {len(fitted.values)} parameters")
        lines += [f"  {line}" for line in _parameter_lines(fitted)]
        lines += [f"  {_outage_line(check)}" for check in identification.outages[name]]
    return [*lines, identification.model_choice]


def _parameter_lines(fitted: FittedModel) -> Iterator[str]:
    for what in fitted.model.suite_parameters:
        value, log_sigma = fitted.suite_value(what)
        yield f"{what.name:45}{value:12.4g} {what.unit:12}{uncertainty_text(log_sigma)}"
    for parameter, value, log_sigma in zip(fitted.model.parameters, fitted.values, fitted.log_sigmas, strict=True):
        if parameter.name.startswith("2 σ²/τ"):
            low, high = (value * math.exp(sign * _SIGMAS * log_sigma) for sign in (-1.0, 1.0))
            uncertainty = f"{uncertainty_text(float(log_sigma))}, 99.9 %: {low:.3g} to {high:.3g}"
            yield f"{parameter.name:45}{value:12.4g} {'':12}{uncertainty}"
    for name, fixed in fitted.model.configured_values.items():
        yield f"{name:45}{fixed:12.4g} {'':12}as configured"


def _outage_line(check: OutageCheck) -> str:
    parts = [
        f"{name} {missed.rms_arcsec:.1f}″ (σ {missed.sigma_arcsec:.1f}″, NEES {missed.nees:.1f} of at most "
        f"{missed.nees_limit:.1f})"
        for name, missed in check.parts.items()
    ]
    return f"{check.horizon_s:.0f} s without stars, {check.intervals} times: {', '.join(parts)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="identify_noise",
        example="night.mcap --out noise.yaml",
        epilog="exit code: 0 identified, with or without warnings; 2 bad input or usage, with a one-line reason; 130 "
        "interrupted",
        description="Identify the error model of the INS from a bag with ins/imu, star sensors and, for the model "
        "schuler, gnss/fix: white noise, Gauss-Markov or Schuler, by maximum likelihood over the innovations of the "
        "star attitudes. Prints which model fits, the uncertainty of each parameter [1 sigma], and where predictions "
        "over parts of the record without stars were worse than predicted.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument(
        "--config", type=Path, metavar="SUITE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE.yaml", help="parameter file to write: section ins of ship_attitude"
    )
    add_bag_name_options(parser)
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.out is not None:
        if options.out.resolve() == options.bag.resolve():
            raise BadInput("the output would overwrite the input", file=options.out)
        check_file(options.out, options.force)
    identification = identify(run_session(options.bag, options.config, options.namespace, progress=with_bag_progress))
    sys.stdout.writelines(f"{line}\n" for line in result_lines(identification))
    sys.stdout.writelines(f"warning: {line}\n" for line in identification.warnings)
    if options.out is not None:
        write_atomically(options.out, parameter_file_text(identification))
        sys.stdout.write(f"parameters: {options.out}\n")
    return EXIT_DONE
