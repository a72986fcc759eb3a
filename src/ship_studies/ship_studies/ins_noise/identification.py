"""Selection of the INS's error model for a record, with its parameters and warnings."""

import math
from dataclasses import dataclass

from ship_bags.errors import BadInput
from ship_estimation.parameters.ins_errors import GAUSS_MARKOV
from ship_studies.ins_noise.fit import FittedModel, fit
from ship_studies.ins_noise.outage import OutageCheck, outage_checks
from ship_studies.ins_noise.processes import candidate_models
from ship_studies.ins_noise.session import NoiseSession, mean_location
from ship_studies.ins_noise.star_record import StarRecord, star_record

TIMES_NEEDED = 200.0
"""Length of a record, in correlation times τ, needed for σ within 10 % and τ within 30 %."""

_LEAST_EPOCHS = 50
_CLEAR = 10.0
"""Difference of AIC for a clear selection (Burnham and Anderson 2002, §2.6)."""

_EXPECTED_REFUSED = 0.01
_VAGUE = 0.3
_HOUR_S = 3600.0


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
