"""Tables of an evaluation for the terminal."""

import math

from rich.console import Console
from rich.table import Table

from ship_node.pages.console_tables import console_table
from ship_replay.evaluation.evaluate import AlignmentValue, Evaluation

STATISTICS = ("rms_arcsec", "bias_arcsec", "sigma_arcsec", "rms_over_sigma")
"""Statistics of a channel in tables of errors."""

_SHOWN = {
    "arcsec": (1.0, 2, "arcsec"),
    "deg": (1.0, 5, "deg"),
    "s": (1e3, 3, "ms"),
    "m": (1e3, 4, "mm"),
    "px": (1.0, 3, "px"),
    "1": (1e2, 4, "%"),
}
"""Unit of a value → factor, decimals and unit in the table."""


def print_evaluation(evaluation: Evaluation, console: Console) -> None:
    """Print each table for which there are values."""
    if evaluation.errors:
        console.print(attitude_table(evaluation))
        for label, count in evaluation.invalid_counts.items():
            if count:
                console.print(f"{label}: INVALID messages: {count}")
    if evaluation.targets:
        console.print(target_table(evaluation))
    if evaluation.innovations:
        console.print(innovation_table(evaluation))
    for kind, values in evaluation.estimates.items():
        console.print(estimate_table(kind, values))


def attitude_table(evaluation: Evaluation) -> Table:
    """Return RMS, bias, predicted sigma and RMS/sigma by source and channel, and NEES by source."""
    groups = []
    for errors in evaluation.errors:
        values = errors.statistics()
        of_source = value_text(values["nees_mean"]), f"{values['samples']:.0f}"
        groups.append([
            [
                errors.label if name == errors.channels[0] else "",
                name,
                *(value_text(values[f"{name}.{what}"]) for what in STATISTICS),
                *(of_source if name == errors.channels[0] else ()),
            ]
            for name in errors.channels
        ])
    columns = "source", "angle", ">RMS", ">bias", ">predicted σ", ">RMS/σ", ">NEES (3)", ">samples"
    return console_table("Error against the truth, arcseconds", columns, groups)


def target_table(evaluation: Evaluation) -> Table:
    """Return RMS errors of directions (per transverse axis) and positions, predicted sigmas and NEES, by target."""
    rows = []
    for target_id, errors in evaluation.targets.items():
        values = errors.statistics()
        shown = [f"direction.{name}" for name in ("rms_arcsec", "sigma_arcsec", "nees_mean")]
        placed = [f"position.{name}" for name in ("rms_m", "sigma_m", "nees_mean")]
        rows.append([
            target_id,
            *(value_text(values[name]) for name in shown),
            f"{values['samples']:.0f}",
            *(value_text(values.get(name, math.nan)) for name in placed),
            f"{values.get('position.samples', 0.0):.0f}",
        ])
    direction = ">direction RMS (arcsec)", ">predicted σ", ">NEES (2)", ">samples"
    position = ">position RMS (m)", ">predicted σ", ">NEES (3)", ">samples"
    return console_table("Targets against the truth", ["target", *direction, *position], [rows])


def innovation_table(evaluation: Evaluation) -> Table:
    """Return mean, deviation and predicted sigma by source and component; NIS and counts by source.

    An accepted exposure counts as one measurement, but each of its excluded stars counts as one rejection.
    """
    groups = []
    for source, innovations in evaluation.innovations.items():
        values = innovations.statistics()
        reasons = ", ".join(f"{name} {count}" for name, count in sorted(innovations.rejected.items()))
        share = values.get("nis_windows_in_band")
        per_source = [
            f"{values['nis_mean']:.2f} ({values['nis_degrees']:.3g})" if "nis_mean" in values else "-",
            "-" if share is None else f"{100 * share:.0f} %",
            f"{values['accepted']:.0f}",
            f"{values['refused']:.0f}" + (f" ({reasons})" if reasons else ""),
        ]
        names = [name for name in innovations.components() if f"{name}.std_arcsec" in values]
        rows = [
            ["", name, *(value_text(values[f"{name}.{what}_arcsec"]) for what in ("mean", "std", "sigma"))]
            for name in names
        ] or [["", "-", "-", "-", "-"]]
        rows[0] = [source, *rows[0][1:], *per_source]
        groups.append(rows)
    columns = (
        *("source", "component", ">mean", ">deviation", ">predicted σ", ">NIS (deg. of freedom)"),
        *(">minutes with NIS in band", ">accepted (measurements)", ">rejected (messages, stars)"),
    )
    return console_table("Measurement - prediction, arcseconds", columns, groups)


def estimate_table(kind: str, values: list[AlignmentValue]) -> Table:
    """Return the last estimates of a filter with their sigma."""
    rows = []
    for item in values:
        scale, places, unit = _SHOWN[item.unit]
        rows.append([item.name, f"{item.value * scale:.{places}f}", f"{item.sigma * scale:.{places}f}", unit])
    return console_table(f"{kind.capitalize()} at the end", ["quantity", ">value", ">σ", "unit"], [rows])


def value_text(value: float) -> str:
    """Return a value with two decimals; a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.2f}"
