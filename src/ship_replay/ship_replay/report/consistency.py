"""Whether stated sigmas fit: a row for each NEES and NIS, and the words for it."""

import math

from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.report.wording import number

_NIS_BAND = 3.3


def consistency(evaluation: Evaluation) -> list[dict[str, str]]:
    """A row for each NEES and NIS: mean, what is expected, and in words whether σ fits.

    The numbers are those of ``evaluate``. Errors against the truth hang together over minutes, so that of NEES only
    the ratio is told and no band; of NIS the share of minutes in their 99.9 % band, as ``evaluate`` counts them.
    """
    rows = []
    for series in evaluation.errors:
        mean = series.statistics()["nees_mean"]
        rows.append(_consistency_row("NEES", series.label, mean, 3.0, len(series.time_ns), None))
    for source, part in evaluation.innovations.items():
        values = part.statistics()
        if "nis_mean" in values:
            rows.append(
                _consistency_row(
                    "NIS", source, values["nis_mean"], values["nis_degrees"], len(part.compared),
                    values.get("nis_windows_in_band"),
                )
            )
    return rows


def _consistency_row(
    kind: str, name: str, mean: float, degrees: float, count: int, in_band: float | None
) -> dict[str, str]:
    ratio = math.sqrt(mean / degrees) if mean >= 0.0 and degrees > 0.0 else math.nan
    band = _NIS_BAND / math.sqrt(2.0 * degrees * count) if degrees > 0.0 and count else math.inf
    if not math.isfinite(ratio) or not band <= 0.5:
        words = "too few to tell"
    elif abs(ratio - 1.0) <= (band if kind == "NIS" else 0.25):
        words = f"σ as stated ({ratio:.2f})"
    else:
        words = f"σ optimistic by {ratio:.2f}" if ratio > 1.0 else f"σ pessimistic by {1.0 / ratio:.2f}"
    return {
        "kind": kind, "name": name, "mean": number(mean), "degrees": number(degrees), "count": f"{count}",
        "in_band": "" if in_band is None else f"{100.0 * in_band:.0f} %", "words": words,
    }
