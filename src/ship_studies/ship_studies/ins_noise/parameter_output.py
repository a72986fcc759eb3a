"""Result of an identification as a parameter file of the suite, and as text for people."""

import math
from collections.abc import Iterator

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.parameter_yaml import PARAMETERS_KEY, in_any_namespace
from ship_studies.ins_noise.fit import FittedModel
from ship_studies.ins_noise.identification import Identification, uncertainty_text
from ship_studies.ins_noise.outage import OutageCheck

_SIGMAS = 3.290526731491891
"""Number of sigmas of a two-sided 99.9 % interval."""


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
