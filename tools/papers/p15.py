"""[P15]: the worked example, step by step, and a note on the paper's trial on a moored ship."""

from collections.abc import Iterator

import numpy as np

from ship_geometry.air.refraction import elevation_of, refraction
from ship_geometry.earth.star_directions import directions
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_testing.worked_example import (
    ORIENTATION,
    SHIP,
    STAR,
    TIME_NS,
    UT1_TAKEN_AS_UTC,
    WEATHER,
    angles_deg,
    shift_arcsec,
    without_aberration,
)
from tools.papers.table import Row, rows_table, table

PRINTED_V = np.array([0.229426, 0.671988, 0.704128])
PRINTED_AZIMUTH_DEG, PRINTED_ELEVATION_DEG = 71.9528, 42.2207
PRINTED_REFRACTION_ARCSEC, PRINTED_RAISED_DEG = 59.34, 42.2372

_HIDDEN = "table below"


def section() -> str:
    """Return the section of the page about this paper."""
    columns = ("corrections", "azimuth", "elevation", "difference: azimuth · cos E", "difference: elevation")
    added = table(columns, steps())
    return f"""## [P15]: attitude from two star sensors

### The worked example

2014-07-09 11:50:07.8 UTC, 31.945213° N, 120.293086° E, 28.2 °C, 1008.3 hPa. The paper does not name its star: the
direction V is that of β Lyrae, HIP 92420.

{rows_table(example())}
Our values have no aberration and UT1 = UTC, presumably as in the paper. Values *in full* include both corrections. In
the following table each row adds one correction. *Difference* is our direction minus the printed one, which is rounded
to 0.2″.

{added}
The printed direction lacks both corrections, together {_missing_arcsec():.0f}″. The suite applies them; tests check
both. The remaining 2.8″ of elevation in the first row are not explained.

### The trial alongside

The paper compares the attitudes from two sensors with those of a strapdown INS with laser gyros on a moored ship. One
sensor identified five stars, the other three. No printed values can be compared, because our text lacks:

- tables 1 and 2: the sensors and their identified stars;
- the vectors and matrices of the example;
- figure 4 and its numbers.

[Availability](explanation/availability.md) has such a trial (scenario `mooring`), and a comparison with the methods
that the paper replaces.
"""


def chain() -> list[tuple[str, FloatArray]]:
    """Return each correction's name, and the star's unrefracted direction in n after this correction, shape (3,)."""
    ut1 = f"{float(ORIENTATION.ut1_minus_utc_s):.4f} s".replace("-", "−")
    return [
        ("no aberration, UT1 = UTC", without_aberration(UT1_TAKEN_AS_UTC, diurnal=False)),
        ("+ annual and diurnal aberration", directions(STAR, TIME_NS, SHIP, UT1_TAKEN_AS_UTC)),
        (f"+ UT1 − UTC = {ut1}", directions(STAR, TIME_NS, SHIP, ORIENTATION)),
    ]


def example() -> Iterator[Row]:
    """Yield the values that the paper prints for its example."""
    first_n, last_n = chain()[0][1], chain()[-1][1]
    for name, printed, bare, full in zip(("North", "Up", "East"), PRINTED_V, first_n, last_n, strict=True):
        yield Row(f"V, {name}", f"{printed:.6f}", f"{bare:.6f}; in full {full:.6f}", _HIDDEN)
    for name, printed, bare, full in zip(
        ("azimuth", "elevation"), _PRINTED_DEG, angles_deg(first_n), angles_deg(last_n), strict=True
    ):
        yield Row(f"{name}, before refraction", f"{printed:.4f}°", f"{bare:.4f}°; in full {full:.4f}°", _HIDDEN)
    elevation = np.deg2rad(PRINTED_ELEVATION_DEG)
    almanac, erfa = (float(refraction(model, elevation, WEATHER).angle) / ARCSEC for model in ("almanac", "erfa"))
    yield Row(
        "refraction at that elevation, (8)–(12)",
        f"{PRINTED_REFRACTION_ARCSEC:.2f}″",
        f"{almanac:.3f}″; by `erfa` {erfa:.2f}″",
        "our text lacks α below 45°; with α = 1 the values agree",
    )
    raised_deg = PRINTED_ELEVATION_DEG + almanac / 3600.0
    yield Row("elevation, after refraction", f"{PRINTED_RAISED_DEG:.4f}°", f"{raised_deg:.4f}°")


_PRINTED_DEG = (PRINTED_AZIMUTH_DEG, PRINTED_ELEVATION_DEG)


def steps() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the chain, with the difference of each direction from the printed direction."""
    printed_n = _direction(*np.deg2rad(_PRINTED_DEG))
    for words, direction_n in chain():
        azimuth_deg, elevation_deg = angles_deg(direction_n)
        off = [f"{round(value, 1) + 0.0:.1f}″".replace("-", "−") for value in shift_arcsec(printed_n, direction_n)]
        yield words, f"{azimuth_deg:.5f}°", f"{elevation_deg:.5f}°", *off


def _missing_arcsec() -> float:
    """Return the angle between the first and the last direction of the chain, arcsec."""
    return float(np.linalg.norm(shift_arcsec(chain()[0][1], chain()[-1][1])))


def _direction(azimuth: float, elevation: float) -> FloatArray:
    """Return the direction (North, Up, East)."""
    level = np.cos(elevation)
    direction_n = np.array([level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)])
    assert np.isclose(elevation_of(direction_n), elevation)
    return direction_n
