"""Draws docs/figures/frames.png: each frame of the glossary in :mod:`ship_geometry`, by the suite's own rotations.

Example:
    python tools/draw_frames.py
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from ship_geometry.earth.geodetic import rotation_horizon_from_ecef
from ship_geometry.frames import ENU_FROM_HORIZON, FLU_FROM_DEVICE, rotation_from_angles
from ship_geometry.rotations import FloatArray, exp_rotation

PATH = Path(__file__).resolve().parents[1] / "docs" / "figures" / "frames.png"
COLOURS = {"forward": "#c0392b", "up": "#1f77b4", "right": "#2e8b57"}
DEVICE = tuple(COLOURS.values())
GREY, INK = "#9aa3ab", "#22303c"
_IDENTITY = np.eye(3)
_UP = _IDENTITY[1]
_ORIGIN = np.zeros(3)
_HALO = (withStroke(linewidth=3.0, foreground="white"),)
"""White outline of each label, which hides lines behind the label."""


class Panel:
    """One drawing of points (North, Up, East), seen from above and from the southwest.

    Args:
        axes: axes of the drawing.
        title: heading of the drawing.
        view: azimuth and elevation of the direction to the viewer, degrees.
    """

    def __init__(self, axes: Axes, title: str, view: tuple[float, float] = (208.0, 27.0)) -> None:
        self.to_eye, up, _ = rotation_from_angles(*np.deg2rad([*view, 0.0])).T
        self._screen = np.stack([np.cross(up, self.to_eye), up], axis=1)
        self._axes = axes
        axes.set_title(title, fontsize=11.5, color=INK)
        axes.set_aspect("equal")
        axes.axis("off")
        axes.set_xlim(-1.58, 1.58)
        axes.set_ylim(-1.0, 1.32)

    def project(self, points_n: FloatArray) -> FloatArray:
        """Return the positions of points on the page, shape (..., 2)."""
        return np.asarray(points_n, dtype=float) @ self._screen

    def line(self, points_n: FloatArray, **style: object) -> None:
        """Draw a line through points, shape (k, 3)."""
        self._axes.plot(*self.project(points_n).T, **({"color": GREY, "lw": 1.0} | style))

    def shape(self, points_n: FloatArray, colour: str = "#dfe5ea") -> None:
        """Draw a filled outline, shape (k, 3)."""
        self._axes.fill(*self.project(points_n).T, facecolor=colour, edgecolor=GREY, lw=1.0, zorder=0.5)

    def text(self, point_n: FloatArray, words: str, colour: str = INK, **style: object) -> None:
        """Draw text at a point."""
        options = {"fontsize": 9.5, "ha": "center", "va": "center", "zorder": 6, "path_effects": _HALO} | style
        self._axes.text(*self.project(point_n), words, color=colour, **options)

    def arrow(self, start_n: FloatArray, along_n: FloatArray, words: str, colour: str, dashed: bool = False) -> None:
        """Draw an arrow with its name beyond its point."""
        start, end = self.project(start_n), self.project(np.add(start_n, along_n))
        style = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
        self._axes.annotate("", end, start, arrowprops=style | ({"linestyle": "--"} if dashed else {}), zorder=4)
        way = end - start
        beyond = end + 0.13 * way / max(float(np.hypot(*way)), 1e-9)
        side = "left" if way[0] > 0.15 else "right" if way[0] < -0.15 else "center"
        steep = side == "center"
        level = "bottom" if steep and way[1] > 0.0 else "top" if steep else "center"
        beyond = end if steep else beyond
        self._axes.text(*beyond, words, color=colour, fontsize=9.5, ha=side, va=level, zorder=6, path_effects=_HALO)

    def frame(
        self, origin_n: FloatArray, rotation: FloatArray, names: tuple[str, ...], length: float = 1.0, **style: bool
    ) -> None:
        """Draw the axes of a frame, which are the columns of a rotation into (North, Up, East)."""
        for axis_n, name, colour in zip(rotation.T, names, DEVICE, strict=True):
            self.arrow(origin_n, length * axis_n, name, colour, **style)

    def arc(
        self,
        start_n: FloatArray,
        turn_n: FloatArray,
        words: str,
        radius: float,
        label: tuple[float, float],
        centre_n: FloatArray = _ORIGIN,
    ) -> None:
        """Draw the path of a direction rotated by a rotation vector, and a line from its middle to its label.

        Args:
            start_n: direction at the beginning.
            turn_n: rotation vector.
            words: the label.
            radius: radius of the path.
            label: centre of the label on the page.
            centre_n: centre of the path.
        """
        path = np.array([radius * exp_rotation(part * turn_n) @ start_n for part in np.linspace(0.0, 1.0, 41)])
        path += centre_n
        self.line(path, color=INK, lw=1.2)
        leader = {"arrowstyle": "-", "color": INK, "lw": 0.6, "shrinkA": 1, "shrinkB": 0}
        style = {"fontsize": 9.5, "ha": "center", "va": "center", "zorder": 6, "path_effects": _HALO}
        self._axes.annotate(words, self.project(path[20]), label, color=INK, arrowprops=leader, **style)

    def circle(
        self, radius: float, normal_n: FloatArray = _UP, centre_n: FloatArray = _ORIGIN, **style: object
    ) -> None:
        """Draw a circle about a normal."""
        first = np.cross(normal_n, [0.3, 0.2, 0.9])
        first = first / np.linalg.norm(first)
        turns = [exp_rotation(angle * np.asarray(normal_n)) @ first for angle in np.linspace(0.0, 2.0 * np.pi, 91)]
        self.line(np.asarray(centre_n) + radius * np.array(turns), **style)


def hull(rotation_nd: FloatArray, scale: float = 1.0) -> FloatArray:
    """Return the outline of a ship's deck, points (North, Up, East)."""
    bow, starboard = rotation_nd[:, 0], rotation_nd[:, 2]
    outline = ((1.25, 0.0), (0.8, 0.26), (0.2, 0.34), (-0.9, 0.3), (-0.9, -0.3), (0.2, -0.34), (0.8, -0.26))
    return scale * np.array([ahead * bow + aside * starboard for ahead, aside in outline])


def box(centre_n: FloatArray, rotation: FloatArray, panel: Panel, size: tuple[float, float, float]) -> None:
    """Draw a device as a box: the three visible faces of a cuboid."""
    half = 0.5 * np.array(size)
    for axis in range(3):
        for side in (-1.0, 1.0):
            one, other = (axis + 1) % 3, (axis + 2) % 3
            if side * rotation[:, axis] @ panel.to_eye <= 0.0:
                continue
            corners = np.zeros((4, 3))
            corners[:, axis] = side * half[axis]
            corners[:, one] = half[one] * np.array([-1.0, 1.0, 1.0, -1.0])
            corners[:, other] = half[other] * np.array([-1.0, -1.0, 1.0, 1.0])
            panel.shape(np.asarray(centre_n) + corners @ rotation.T, "#eef1f4")


def draw_horizon(panel: Panel) -> None:
    """Draw the horizon frame n, and the two angles of a direction in n."""
    panel.circle(1.0)
    panel.frame(_ORIGIN, _IDENTITY, ("North", "Up", "East"))
    star = rotation_from_angles(*np.deg2rad([155.0, 42.0, 0.0]))
    level = rotation_from_angles(*np.deg2rad([155.0, 0.0, 0.0]))
    panel.arrow(_ORIGIN, 1.2 * star[:, 0], "a star ★", INK)
    panel.line(np.array([_ORIGIN, level[:, 0]]), ls="--")
    panel.arc(_IDENTITY[0], np.deg2rad(-155.0) * _UP, "azimuth", 0.6, (0.55, 0.98))
    panel.arc(level[:, 0], np.deg2rad(42.0) * level[:, 2], "elevation", 0.95, (1.2, -0.48))


def draw_deck(panel: Panel) -> None:
    """Draw the deck frame d in n."""
    rotation_nd = rotation_from_angles(*np.deg2rad([105.0, 8.0, 10.0]))
    panel.circle(1.0)
    panel.shape(hull(rotation_nd, 0.75))
    panel.arrow(_ORIGIN, 1.3 * _IDENTITY[0], "North", GREY)
    panel.frame(_ORIGIN, rotation_nd, ("bow", "up", "starboard"), 1.2)
    panel.arc(_IDENTITY[0], np.deg2rad(-105.0) * _UP, "heading", 0.6, (0.6, 0.8))


def draw_star_sensor(panel: Panel) -> None:
    """Draw a star sensor with its frame s on the deck."""
    panel.shape(hull(_IDENTITY, 0.9))
    panel.arrow(_ORIGIN, 1.9 * _IDENTITY[0], "bow", GREY)
    rotation_ds = rotation_from_angles(*np.deg2rad([60.0, 40.0, 0.0]))
    level = rotation_from_angles(*np.deg2rad([60.0, 0.0, 0.0]))
    box(_ORIGIN, rotation_ds, panel, (0.34, 0.2, 0.2))
    panel.frame(_ORIGIN, rotation_ds, ("boresight", "up", "right"), 1.05)
    panel.line(np.array([_ORIGIN, level[:, 0]]), ls="--")
    panel.arc(_IDENTITY[0], np.deg2rad(-60.0) * _UP, "A0", 0.7, (-0.02, 0.92))
    panel.arc(level[:, 0], np.deg2rad(40.0) * level[:, 2], "E0", 0.75, (1.05, 0.62))


def draw_device(panel: Panel) -> None:
    """Draw a device with its frame, which stands for i, r and v."""
    rotation = rotation_from_angles(*np.deg2rad([75.0, 10.0, -8.0]))
    box(_ORIGIN, rotation, panel, (0.8, 0.35, 0.5))
    panel.frame(_ORIGIN, rotation, ("forward", "up", "right"), 1.15)


def draw_drone(panel: Panel) -> None:
    """Draw a drone with its frame b, its light and the lever arm from drone to light."""
    rotation_nb = rotation_from_angles(*np.deg2rad([70.0, 6.0, 5.0]))
    for angle in (45.0, 135.0, 225.0, 315.0):
        arm = 0.7 * rotation_nb @ rotation_from_angles(np.deg2rad(angle), 0.0, 0.0)[:, 0]
        panel.line(np.array([_ORIGIN, arm]), lw=2.0)
        panel.circle(0.24, rotation_nb[:, 1], arm)
    panel.frame(_ORIGIN, rotation_nb, ("nose", "up", "right"), 1.1)
    lever = rotation_nb @ np.array([0.1, -0.55, 0.05])
    panel.line(np.array([_ORIGIN, lever]), color=INK, ls=":")
    panel.text(lever, "●", "#d4a017", fontsize=13)
    panel.text(lever + np.array([0.0, -0.3, 0.0]), "light, at its lever")


def draw_theodolite(panel: Panel) -> None:
    """Draw the theodolite with its frames f, x, m and t."""
    foot, top = np.array([0.0, -0.72, 0.0]), np.array([0.0, 0.3, 0.0])
    panel.shape(foot + hull(_IDENTITY, 0.6))
    panel.frame(foot, _IDENTITY, ("f: bow", "", "f: starboard"), 0.95, dashed=True)
    rotation_dx = rotation_from_angles(*np.deg2rad([105.0, 0.0, 0.0]))
    rotation_dm = rotation_from_angles(*np.deg2rad([105.0, 35.0, 0.0]))
    panel.line(np.array([foot, top]), color=INK, lw=3.0)
    panel.arrow(top, 0.95 * rotation_dx[:, 0], "x: forward", GREY, dashed=True)
    box(top, rotation_dm, panel, (0.6, 0.2, 0.2))
    panel.frame(top, rotation_dm, ("m: optical axis", "m: up", "m: right"), 0.95)
    telescope = top + 0.3 * rotation_dm[:, 1] - 0.1 * rotation_dm[:, 0]
    box(telescope, rotation_dm, panel, (0.35, 0.12, 0.12))
    tilted = rotation_dm @ rotation_from_angles(*np.deg2rad([-6.0, 5.0, 0.0]))
    panel.arrow(telescope, 1.0 * tilted[:, 0], "t", "#8e44ad")
    panel.arc(rotation_dx[:, 0], np.deg2rad(35.0) * rotation_dx[:, 2], "E", 0.6, (1.0, 0.55), top)


def draw_earth(panel: Panel) -> None:
    """Draw the frames e of the Earth, c of the sky, and n on the Earth, with the Earth's pole up."""
    world_from_ecef = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    world_from_ecef = exp_rotation(np.deg2rad(-255.0) * _UP) @ world_from_ecef
    for tilt in (0.0, 45.0, 90.0, 135.0):
        panel.circle(0.9, exp_rotation(np.deg2rad(tilt) * _UP)[:, 0], lw=0.5)
    panel.circle(0.9, _UP, lw=0.8)
    names = ("e: x", "e, c: z, pole", "e: y")
    panel.frame(_ORIGIN, world_from_ecef[:, [0, 2, 1]], names, 1.25)
    celestial = world_from_ecef @ np.array([np.cos(0.75), np.sin(0.75), 0.0])
    panel.arrow(_ORIGIN, 1.2 * celestial, "c: x", "#8e44ad")
    place = np.deg2rad([15.0, 110.0])
    rotation_wn = world_from_ecef @ rotation_horizon_from_ecef(*place).T
    ship = 0.9 * rotation_wn[:, 1]
    for axis, name in zip(rotation_wn.T, ("n: North", "n: Up", "n: East"), strict=True):
        panel.arrow(ship, 0.5 * axis, name, INK)


def draw_ros(panel: Panel) -> None:
    """Draw the frames of ROS next to n and d of a ship that heads north."""
    panel.shape(hull(_IDENTITY, 0.8))
    names_n, names_d = ("North", "Up", "East"), ("bow", "up", "starboard")
    enu = [f"ENU {'xyz'[int(np.argmax(column))]}" for column in ENU_FROM_HORIZON.T]
    for axis, (name_n, name_d, ros) in enumerate(zip(names_n, names_d, enu, strict=True)):
        flu = int(np.argmax(np.abs(FLU_FROM_DEVICE[:, axis])))
        sign = "−" if FLU_FROM_DEVICE[flu, axis] < 0.0 else ""
        words = f"{name_n} ({ros})\n{name_d}\n(FLU {sign}{'xyz'[flu]})"
        panel.arrow(_ORIGIN, 0.85 * _IDENTITY[axis], words, DEVICE[axis])


DRAWINGS = (
    ("n: horizon", draw_horizon),
    ("d: deck, in n", draw_deck),
    ("s: star sensor, in d", draw_star_sensor),
    ("i, r, v: INS, reference, any device", draw_device),
    ("f, x, m, t: theodolite", draw_theodolite),
    ("b: a body, here a drone", draw_drone),
    ("e: Earth, c: sky; n on the Earth", draw_earth),
    ("ROS: ENU and FLU, heading north", draw_ros),
)


def main(path: Path = PATH) -> None:
    """Write the figure."""
    with mpl.rc_context({"font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(13.0, 6.0))
        for axes, (title, draw) in zip(figure.subplots(2, 4).ravel(), DRAWINGS, strict=True):
            draw(Panel(axes, title))
        figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.95, wspace=0.04, hspace=0.12)
        figure.savefig(path, dpi=100, metadata={"Software": None})
    sys.stdout.write(f"{path.name} written\n")


if __name__ == "__main__":
    main()
