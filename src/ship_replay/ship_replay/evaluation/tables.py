"""Tables of an evaluation for the terminal."""

import math

from rich.console import Console
from rich.table import Table

from ship_replay.evaluation.evaluate import AlignmentValue, Evaluation

_SHOWN = {
    "arcsec": (1.0, 2, "arcsec"),
    "deg": (1.0, 5, "deg"),
    "s": (1e3, 3, "ms"),
    "m": (1e3, 4, "mm"),
    "px": (1.0, 3, "px"),
    "1": (1e2, 4, "%"),
}
"""Unit of a value → factor, decimals and unit in the table."""


_WIDTH_WITHOUT_TERMINAL = 130


def table_console() -> Console:
    """Return the console for tables: as wide as the terminal; wide enough for all columns if there is no terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH_WITHOUT_TERMINAL)


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
    table = Table(title="Error against the truth, arcseconds")
    for column in ("source", "angle"):
        table.add_column(column)
    for column in ("RMS", "bias", "predicted σ", "RMS/σ", "NEES (3)", "samples"):
        table.add_column(column, justify="right")
    for errors in evaluation.errors:
        values = errors.statistics()
        for name in errors.channels:
            first = name == errors.channels[0]
            table.add_row(
                errors.label if first else "",
                name,
                _text(values[f"{name}.rms_arcsec"]),
                _text(values[f"{name}.bias_arcsec"]),
                _text(values[f"{name}.sigma_arcsec"]),
                _text(values[f"{name}.rms_over_sigma"]),
                _text(values["nees_mean"]) if first else "",
                f"{values['samples']:.0f}" if first else "",
                end_section=name == errors.channels[-1],
            )
    return table


def target_table(evaluation: Evaluation) -> Table:
    """Return RMS errors of directions (per transverse axis) and positions, predicted sigmas and NEES, by target."""
    table = Table(title="Targets against the truth")
    table.add_column("target")
    for what, unit, degrees in (("direction", "arcsec", 2), ("position", "m", 3)):
        for column in (f"{what} RMS ({unit})", "predicted σ", f"NEES ({degrees})", "samples"):
            table.add_column(column, justify="right")
    for target_id, errors in evaluation.targets.items():
        values = errors.statistics()
        shown = [f"direction.{name}" for name in ("rms_arcsec", "sigma_arcsec", "nees_mean")]
        placed = [f"position.{name}" for name in ("rms_m", "sigma_m", "nees_mean")]
        table.add_row(
            target_id,
            *(_text(values[name]) for name in shown),
            f"{values['samples']:.0f}",
            *(_text(values.get(name, math.nan)) for name in placed),
            f"{values.get('position.samples', 0.0):.0f}",
        )
    return table


def innovation_table(evaluation: Evaluation) -> Table:
    """Return mean, deviation and predicted sigma by source and component; NIS and counts by source.

    An accepted exposure counts as one measurement, but each of its excluded stars counts as one rejection.
    """
    table = Table(title="Measurement - prediction, arcseconds")
    for column in ("source", "component"):
        table.add_column(column)
    shown = "mean", "deviation", "predicted σ", "NIS (deg. of freedom)", "minutes with NIS in band"
    for column in (*shown, "accepted (measurements)", "rejected (messages, stars)"):
        table.add_column(column, justify="right")
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
        for number, name in enumerate(names):
            table.add_row(
                source if number == 0 else "",
                name,
                *(_text(values[f"{name}.{what}_arcsec"]) for what in ("mean", "std", "sigma")),
                *(per_source if number == 0 else []),
                end_section=number + 1 == len(names),
            )
        if not names:
            table.add_row(source, "-", "-", "-", "-", *per_source, end_section=True)
    return table


def estimate_table(kind: str, values: list[AlignmentValue]) -> Table:
    """Return the last estimates of a filter with their sigma."""
    table = Table(title=f"{kind.capitalize()} at the end")
    table.add_column("quantity")
    for column in ("value", "σ"):
        table.add_column(column, justify="right")
    table.add_column("unit")
    for item in values:
        scale, places, unit = _SHOWN[item.unit]
        table.add_row(item.name, f"{item.value * scale:.{places}f}", f"{item.sigma * scale:.{places}f}", unit)
    return table


def _text(value: float) -> str:
    return "-" if value != value else f"{value:.2f}"
