"""Error, sigma and cost of the models of refraction over elevation: prints the table of the docs, draws its figure.

Errors are relative to a traced ray in the given weather. Costs depend on the machine.

Example:
    python tools/refraction_models.py --figure docs/figures/refraction.png
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_geometry.air.ray_trace import traced_refraction
from ship_geometry.air.refraction import LOWEST_ELEVATION, MODELS, ModelName, Weather, refraction
from ship_geometry.rotations import ARCSEC, FloatArray

ELEVATIONS_DEG = (5.3, 6.0, 7.0, 8.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)
COLOURS: dict[ModelName, str] = {"erfa": "#c0392b", "almanac": "#2e8b57", "ray_trace": "#1f77b4"}
_WAVELENGTH_UM = 0.55
_STARS, _CALLS = 10, 300


def main() -> int:
    """Print the table and optionally the costs; draw the figure if requested."""
    parser = CommandParser(prog="refraction_models", description=__doc__.splitlines()[0])
    parser.add_argument("--pressure", type=float, default=1013.25, help="air pressure, hPa (1013.25)")
    parser.add_argument("--temperature", type=float, default=15.0, help="air temperature, deg C (15)")
    parser.add_argument("--humidity", type=float, default=0.7, help="relative humidity, 0 to 1 (0.7)")
    parser.add_argument("--costs", action="store_true", help="measure the cost of a new weather and of a star, us")
    parser.add_argument("--figure", type=Path, help="PNG file to draw")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    try:
        weather = Weather(options.pressure, options.temperature, options.humidity)
    except ValueError as problem:
        raise BadInput(str(problem)) from problem
    print("\n".join(table(weather)))
    if options.costs:
        print("\n".join(costs(weather)))
    if options.figure:
        draw(weather, options.figure)
    return EXIT_DONE


def errors(model: ModelName, elevation: FloatArray, weather: Weather) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a model's refraction, its error relative to the ray, and its sigma, arcsec, at elevations without air."""
    # Iterate the ray's zenith distance with air: a step multiplies the error by the slope of refraction, 2.5 % at 5°.
    ray = np.zeros_like(elevation)
    for _ in range(12):
        seen = 0.5 * np.pi - elevation - ray
        ray = traced_refraction(
            seen,
            np.array([weather.pressure_hpa]),
            np.array([weather.temperature_c]),
            weather.relative_humidity,
            _WAVELENGTH_UM,
        )[0]
    found = refraction(model, elevation, weather, _WAVELENGTH_UM)
    return found.angle / ARCSEC, (found.angle - ray) / ARCSEC, found.model_sigma / ARCSEC


def table(weather: Weather) -> list[str]:
    """Return the lines of the table with the refraction at each elevation, and error and sigma of each model."""
    elevation = np.deg2rad(ELEVATIONS_DEG)
    columns = {model: errors(model, elevation, weather) for model in MODELS}
    angle = columns["ray_trace"][0]
    lines = ["| elevation | refraction | " + " | ".join(f"`{m}`: error | σ" for m in MODELS) + " |"]
    lines.append("|---:" * (2 + 2 * len(MODELS)) + "|")
    for row, degrees in enumerate(ELEVATIONS_DEG):
        cells = [f"{degrees:g}°", f"{angle[row]:.1f}″"]
        for model in MODELS:
            _, error, sigma = (column[row] for column in columns[model])
            cells += [f"{error + 0.0:+.2f}″", f"{sigma:.2f}″"] if np.isfinite(error) else ["not used", ""]
        lines.append("| " + " | ".join(cells).replace("+0.00", "0.00").replace("-0.00", "0.00") + " |")
    return lines


def costs(weather: Weather) -> list[str]:
    """Return the lines of a table: cost of a new weather, and of each of ten stars in the same weather."""
    elevation = np.full(_STARS, np.deg2rad(45.0))
    lines = ["| model | a new weather | a star |", "|---|---:|---:|"]
    for model in MODELS:
        weathers = [Weather(weather.pressure_hpa - 1e-3 * i, weather.temperature_c) for i in range(_CALLS)]
        changing = _seconds(model, elevation, weathers)
        constant = _seconds(model, elevation, [weather] * _CALLS)
        lines.append(f"| `{model}` | {1e6 * (changing - constant):.0f} µs | {1e6 * constant / _STARS:.1f} µs |")
    return lines


def _seconds(model: ModelName, elevation: FloatArray, weathers: list[Weather]) -> float:
    """Return the median time of a call in each of the weathers in turn, s."""
    times = []
    for weather in weathers:
        begin_s = time.perf_counter()
        refraction(model, elevation, weather)
        times.append(time.perf_counter() - begin_s)
    return float(np.median(times))


def draw(weather: Weather, path: Path) -> None:
    """Draw sizes of the errors as solid lines and sigmas as dashed lines, over elevation."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.subplots()
    for model in MODELS:
        elevation = np.deg2rad(np.geomspace(np.rad2deg(LOWEST_ELEVATION[model]) + 0.01, 60.0, 400))
        _, error, sigma = errors(model, elevation, weather)
        degrees, colour = np.rad2deg(elevation), COLOURS[model]
        if model != "ray_trace":
            axes.plot(degrees, np.abs(error), color=colour, lw=1.6, label=f"{model}: size of the error")
        axes.plot(degrees, sigma, color=colour, lw=1.2, ls="--", label=f"{model}: σ")
    axes.set(xscale="log", yscale="log", xlim=(5.0, 60.0), ylim=(1e-3, 40.0))
    axes.set_xticks([5, 7, 10, 15, 20, 30, 45, 60], labels=["5°", "7°", "10°", "15°", "20°", "30°", "45°", "60°"])
    axes.minorticks_off()
    axes.set(xlabel="elevation without air", ylabel="arcseconds")
    axes.set_title(
        f"Refraction against a traced ray, {weather.pressure_hpa:g} hPa, {weather.temperature_c:g} °C", fontsize=11
    )
    axes.grid(color="#dfe5ea")
    axes.legend(fontsize=9)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
