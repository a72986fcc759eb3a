"""Sky panel: sky over the ship and field of view of each star sensor, with used and rejected stars and residuals.

Equal residual bars indicate a shifted sensor, random bars misidentified stars. The map is round, with North up and
azimuth clockwise, as on a chart: East is to the right. The zenith is the centre and the horizon the rim; the radius is
linear in elevation.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import erfa
import numpy as np
from bokeh.models import Column, ColumnDataSource, InlineStyleSheet, Range1d

from ship_geometry.earth.earth_orientation import OutsideEarthOrientation, earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition, ecef_from_geodetic, rotation_horizon_from_ecef
from ship_geometry.earth.star_directions import RefreshedSky
from ship_geometry.earth.time_scales import tt_julian_date
from ship_geometry.frames import rotation_from_angles
from ship_monitor.plots.figures import (
    NARROW,
    PanelBox,
    ResidualBars,
    draw_frame,
    draw_texts,
    empty_plot,
    empty_source,
    with_mark,
    without_formulas,
)
from ship_monitor.themes import Theme
from ship_watch.history.history import ExposurePoint, History, ParameterEstimate
from ship_watch.suite_state import AngleState, Presence, SourceDetails, SuiteState

_AU_M = 149_597_870_700.0

MAX_FIELDS = 3
"""Maximum number of fields of view."""

BAR_STEPS_ARCSEC = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Possible residuals of a bar of full length, arcsec."""

_FIELD_ON_MAP = 0.085
"""Half side of a field of view on the map: not to scale, so that single stars are visible."""

_FIELD_PX = 256.0


class SkyPanel:
    """Panel with the map, and the fields of view of up to :data:`MAX_FIELDS` sensors that publish single stars.

    Attributes:
        box: the panel.
    """

    def __init__(self, theme: Theme, *, is_bag: bool = False) -> None:
        self._theme = theme
        self._map = _SkyMap(theme, is_bag=is_bag)
        self._fields: dict[str, _Field] = {}
        self._column = Column(children=[], sizing_mode="stretch_width")
        self._columns = InlineStyleSheet(css=_columns_css(has_fields=False))
        both = Column(
            children=[self._map.figure, self._column], sizing_mode="stretch_width", stylesheets=[self._columns]
        )
        self.box = PanelBox(theme, "Sky", [both])

    def update(self, history: History, suite_state: SuiteState, marked: str) -> None:
        """Draw the last exposures.

        Args:
            history: history with the exposures.
            suite_state: state with the sources and the attitude.
            marked: marked source; empty if no source is marked. The field of the marked source precedes other fields,
                except the fields of sources that are OUT.
        """
        sources = {source.name: source for source in suite_state.sources}
        names = [name for name, exposure in sorted(history.star_exposures.items()) if len(exposure.u)]
        names = sorted(names, key=lambda name: (not _is_out(sources.get(name)), name != marked))[:MAX_FIELDS]
        if names != list(self._fields):
            self._fields = {name: self._fields.get(name) or _Field(self._theme) for name in names}
            self._column.children = [field.figure for field in self._fields.values()]
            self._columns.css = _columns_css(has_fields=bool(names))
        for name, field in self._fields.items():
            field.update(
                _short_name(name), history.star_exposures[name], sources.get(name), len(names), is_marked=name == marked
            )
        note = self._map.update(history, suite_state, sources, marked)
        self.box.set_subtitle(f"fields of view not to scale · bars: residuals{note}")


def _columns_css(*, has_fields: bool) -> str:
    """Return the CSS of the columns: the map in the middle, or the map with the fields at its right."""
    columns = "minmax(0,11fr) minmax(0,9fr)" if has_fields else "minmax(0,560px)"
    return (
        f":host{{display:grid;justify-content:center;grid-template-columns:{columns}}}"
        f"{NARROW}{{:host{{grid-template-columns:minmax(0,1fr)}}}}"
    )


class _SkyMap:
    """Map of the sky."""

    def __init__(self, theme: Theme, *, is_bag: bool) -> None:
        self._theme = theme
        self._no_moon = f" · Moon not drawn: no GNSS position{' in this bag' if is_bag else ''}"
        self.figure = empty_plot(theme, 320, Range1d(-1.32, 1.32), Range1d(-1.2, 1.2))
        self.figure.update(height=None, sizing_mode="scale_width", aspect_ratio=1.1, max_width=560)
        self.figure.update(min_border=0, outline_line_color=None)
        self.figure.axis.visible = False
        self.figure.grid.visible = False
        rings = {"line_color": [theme.second_text, theme.grid, theme.grid], "radius": [1.0, 2 / 3, 1 / 3]}
        centres = ColumnDataSource({"x": [0] * 3, "y": [0] * 3, **rings})
        self.figure.circle("x", "y", radius="radius", fill_color=None, line_color="line_color", source=centres)
        winds = ColumnDataSource({"x": [0.0, 1.1, 0.0, -1.1], "y": [1.1, 0.0, -1.1, 0.0], "text": list("NESW")})
        draw_texts(self.figure, winds, text_color=theme.second_text, text_align="center", text_baseline="middle")
        self._bow = empty_source("x", "y")
        self.figure.line("x", "y", source=self._bow, line_color=theme.second_text, line_dash="dashed")
        self._names = empty_source("x", "y", "text", "colour")
        self._moon = empty_source("x", "y")
        self.figure.scatter("x", "y", source=self._moon, size=15, line_color=theme.second_text, fill_color=None)
        self._squares = empty_source("xs", "ys", "colour", "dash", "width")
        self.figure.multi_line(
            "xs", "ys", source=self._squares, line_color="colour", line_dash="dash", line_width="width"
        )
        self._stars = empty_source("x", "y", "colour", "marker")
        self.figure.scatter(
            "x", "y", source=self._stars, size=3.5, marker="marker", line_color="colour", fill_color="colour"
        )
        draw_texts(self.figure, self._names, text_color="colour", text_baseline="middle")

    def update(self, history: History, suite_state: SuiteState, sources: dict[str, SourceDetails], marked: str) -> str:
        """Draw the directions of the sensors; return an addition to the subtitle."""
        theme = self._theme
        squares: dict[str, list[object]] = {name: [] for name in self._squares.data}
        stars: dict[str, list[object]] = {name: [] for name in self._stars.data}
        names: dict[str, list[object]] = {name: [] for name in self._names.data}
        for name, exposure in sorted(history.star_exposures.items()):
            direction = (exposure.azimuth, exposure.elevation)
            if not np.isfinite(direction).all():
                direction = boresight(name, history.alignment, suite_state.angles)
            if not np.isfinite(direction).all():
                continue
            x, y = map_position(*direction)
            is_bad = _is_out(sources.get(name)) or not exposure.is_accepted
            colour, half = theme.caution_border if is_bad else theme.series[0], _FIELD_ON_MAP
            squares["xs"].append([x - half, x + half, x + half, x - half, x - half])
            squares["ys"].append([y - half, y - half, y + half, y + half, y - half])
            squares["colour"].append(colour)
            squares["dash"].append("dashed" if is_bad else "solid")
            squares["width"].append(4.0 if name == marked else 1.6)
            used, (across, up) = used_star_mask(exposure), positions_in_field(exposure)
            stars["x"] += list(x + half * across)
            stars["y"] += list(y + half * up)
            stars["colour"] += [colour if is_bad else theme.text] * len(exposure.u)
            stars["marker"] += ["circle" if one and not is_bad else "x" for one in used]
            text = with_mark(f"✕ {_short_name(name)}" if is_bad else _short_name(name), name == marked)
            _append(names, x + 1.4 * half, y, text, colour)
        heading = next((angle.value for angle in suite_state.angles if angle.name == "heading"), math.nan)
        bow = [map_position(heading, elevation) for elevation in (0.5 * math.pi, 0.0)] if math.isfinite(heading) else []
        self._bow.data = {"x": [x for x, _ in bow], "y": [y for _, y in bow]}
        if bow:
            _append(names, 1.04 * bow[1][0], 1.06 * bow[1][1], "bow", theme.second_text)
        note = self._draw_moon(history, suite_state, names)
        self._squares.data, self._stars.data, self._names.data = squares, stars, names
        return note

    def _draw_moon(self, history: History, suite_state: SuiteState, names: dict[str, list[object]]) -> str:
        if history.position is None or not suite_state.utc_ns:
            self._moon.data = {"x": [], "y": []}
            return self._no_moon
        direction = moon_direction(suite_state.utc_ns, *history.position)
        if direction is None or not direction[1] > 0.0:
            self._moon.data = {"x": [], "y": []}
            return " · Moon below the horizon" if direction else ""
        x, y = map_position(*direction)
        self._moon.data = {"x": [x], "y": [y]}
        _append(names, x + 0.09, y, "Moon", self._theme.second_text)
        return ""


class _Field:
    """Field of view of one sensor."""

    def __init__(self, theme: Theme) -> None:
        self._theme = theme
        self._size = (_FIELD_PX, _FIELD_PX)
        self._across, self._down = Range1d(0.0, _FIELD_PX), Range1d(_FIELD_PX, 0.0)
        self.figure = empty_plot(theme, 150, self._across, self._down)
        self.figure.update(min_border_left=8)
        self.figure.axis.visible = False
        self.figure.grid.visible = False
        self._used_stars = empty_source("u", "v")
        self._excluded_stars = empty_source("u", "v")
        self._scale = empty_source("x", "y", "text")
        self._bars = ResidualBars(theme, self.figure, BAR_STEPS_ARCSEC)
        self.figure.scatter("u", "v", source=self._used_stars, size=7, line_color=None, fill_color=theme.text)
        self.figure.scatter("u", "v", source=self._excluded_stars, size=8, marker="x", line_color=theme.caution_border)
        scale = {"length": ResidualBars.FULL_PX, "length_units": "screen", "angle": 0.0}
        self.figure.ray("x", "y", source=self._scale, line_color=theme.second_text, line_width=2.5, **scale)
        draw_texts(self.figure, self._scale, text_color=theme.second_text, y_offset=-2, text_baseline="bottom")

    def update(
        self, name: str, exposure: ExposurePoint, source: SourceDetails | None, field_count: int, *, is_marked: bool
    ) -> None:
        """Draw the last exposure; the size of the detector is estimated from all stars so far."""
        theme, is_bad = self._theme, _is_out(source) or not exposure.is_accepted
        width, height = max(self._size[0], _detector_side(exposure.u)), max(self._size[1], _detector_side(exposure.v))
        self._size = width, height
        self._across.update(start=-0.02 * width, end=1.02 * width)
        self._down.update(start=1.03 * height, end=-0.03 * height)
        self.figure.height = 300 if field_count == 1 else 150 if field_count == 2 else 105
        used = used_star_mask(exposure)
        self._used_stars.data = {"u": exposure.u[used], "v": exposure.v[used]}
        self._excluded_stars.data = {"u": exposure.u[~used], "v": exposure.v[~used]}
        has_residuals = len(exposure.residual_right) == len(exposure.u)
        right, up = (
            (exposure.residual_right, exposure.residual_up)
            if has_residuals
            else (np.full(len(exposure.u), np.nan),) * 2
        )
        step = self._bars.draw(exposure.u, exposure.v, right, up, theme.caution_border if is_bad else theme.series[1])
        self._scale.data = {"x": [0.03 * width], "y": [0.93 * height], "text": [f"{step:g}″"]}
        draw_frame(theme, self.figure, is_marked, theme.caution_border if is_bad else theme.border)
        self.figure.outline_line_dash = "dashed" if is_bad else "solid"
        fate = "REJECTED" if is_bad else "used"
        excluded = f" · {exposure.rejected_count} excluded" if exposure.rejected_count else ""
        text = f"{'✕' if is_bad else '✓'} {name}  {exposure.star_count} stars {fate}{excluded}"
        self.figure.title.text = without_formulas(with_mark(text, is_marked))
        self.figure.title.text_color = theme.caution_border if is_bad else theme.text


@lru_cache(maxsize=1)
def _rotating_sky() -> RefreshedSky:
    return RefreshedSky(earth_orientation_table())


def map_position(azimuth: float, elevation: float) -> tuple[float, float]:
    """Return the position on the map, East and North, with the horizon at radius 1; larger radii are below the horizon.

    Args:
        azimuth: azimuth from North to East, rad.
        elevation: elevation, rad.

    Example:
        >>> east, north = map_position(np.deg2rad(90.0), np.deg2rad(45.0))
        >>> print(round(east, 3), round(north, 3))
        0.5 0.0
    """
    radius = 1.0 - elevation / (0.5 * math.pi)
    return radius * math.sin(azimuth), radius * math.cos(azimuth)


def boresight(name: str, alignment: Sequence[ParameterEstimate], angles: Sequence[AngleState]) -> tuple[float, float]:
    """Return azimuth and elevation of a star sensor's boresight, rad, from its installation and the attitude.

    The map uses this direction for sensors that publish attitudes without stars. The result is NaN if an angle is
    unknown.

    Args:
        name: name of the source, "star.<id>".
        alignment: states with the installation angles.
        angles: angles with heading, pitch and roll.
    """
    installed = {state.name: state.value for state in alignment}
    values = {angle.name: angle.value for angle in angles}
    azimuth, elevation = (installed.get(f"{name}.{angle}", math.nan) for angle in ("azimuth", "elevation"))
    deck = [values.get(angle, math.nan) for angle in ("heading", "pitch", "roll")]
    if not np.isfinite([azimuth, elevation, *deck]).all():
        return math.nan, math.nan
    # The installation's azimuth is from the bow to starboard, like an azimuth on a level deck that heads North.
    forward_d = rotation_from_angles(np.asarray(azimuth), np.asarray(elevation), np.asarray(0.0))[:, 0]
    north, up, east = rotation_from_angles(*map(np.asarray, deck)) @ forward_d
    return math.atan2(east, north) % (2.0 * math.pi), math.atan2(up, math.hypot(north, east))


def moon_direction(utc_ns: int, latitude: float, longitude: float) -> tuple[float, float] | None:
    """Return azimuth and elevation of the Moon, rad, without refraction, for an observer at sea level.

    The series of Meeus (ERFA ``moon98``) is accurate to about 10″. The parallax due to the ship's position, up to a
    degree, is included.

    Args:
        utc_ns: UTC as POSIX time, ns.
        latitude: geodetic latitude, rad.
        longitude: longitude, rad.

    Returns:
        Azimuth and elevation; None if the Earth's orientation is unknown for that time.
    """
    place = GeodeticPosition(latitude, longitude, height_m=0.0)
    try:
        rotation_nc = _rotating_sky().rotation_horizon_from_icrs(utc_ns, place)
    except OutsideEarthOrientation:
        return None
    moon_c_m = _AU_M * erfa.moon98(*tt_julian_date(utc_ns))["p"]
    ship_n_m = rotation_horizon_from_ecef(latitude, longitude) @ ecef_from_geodetic(place)
    north, up, east = rotation_nc @ moon_c_m - ship_n_m
    return math.atan2(east, north) % (2.0 * math.pi), math.atan2(up, np.hypot(north, east))


def residual_star_mask(exposure: ExposurePoint) -> np.ndarray:
    """Return a mask of the stars with a residual, shape (n,)."""
    if len(exposure.residual_right) != len(exposure.u):
        return np.zeros(len(exposure.u), bool)
    return np.asarray(np.isfinite(exposure.residual_right) & np.isfinite(exposure.residual_up))


def used_star_mask(exposure: ExposurePoint) -> np.ndarray:
    """Return a mask of the stars drawn as used, shape (n,): those with a residual, or all if no star has a residual."""
    mask = residual_star_mask(exposure)
    return mask if mask.any() else np.ones(len(exposure.u), bool)


def positions_in_field(exposure: ExposurePoint) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of the stars, across and up, in a field of view with half side 1."""
    if not len(exposure.u):
        return np.empty(0), np.empty(0)
    return 2.0 * exposure.u / _detector_side(exposure.u) - 1.0, 1.0 - 2.0 * exposure.v / _detector_side(exposure.v)


def _detector_side(places: np.ndarray) -> float:
    """Estimate the side of a detector, which no topic states, px: a multiple of 256 px beyond all positions."""
    return _FIELD_PX * max(1.0, math.ceil((float(np.max(places)) + 1.0) / _FIELD_PX)) if len(places) else _FIELD_PX


def _short_name(name: str) -> str:
    """Return a sensor's name without "star."."""
    return name.removeprefix("star.")


def _is_out(source: SourceDetails | None) -> bool:
    return source is not None and source.presence is Presence.OUT


def _append(names: dict[str, list[object]], x: float, y: float, text: str, colour: str) -> None:
    for key, value in (("x", x), ("y", y), ("text", text), ("colour", colour)):
        names[key].append(value)
