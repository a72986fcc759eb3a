"""Contradictions between a camera's parameters and its stars in a bag: image axes, focal length, magnitudes."""

from collections.abc import Iterator

from ship_bags.mcap.bag_reader import Bag
from ship_replay.preflight.measured_mounting import MeasuredMounting

_SIGMAS = 5.0
_FOCAL_LENGTH_TOLERANCE = 0.01
"""Relative error of the focal length above which stars near the edge of the image are lost."""

_ACCEPTED_SIGMAS = 2.0
"""Error of the focal length, in its configured standard deviations, that is accepted without a warning."""

_OTHER_BAND = 0.4
"""Offset in magnitudes that indicates another band: V and Hp differ by at most 0.15 on average, B and R from Hp by 0.5
and more."""

_OFFSET_SIGMAS = 3.0


def camera_contradictions(mounting: MeasuredMounting, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    """Yield each contradiction as True (error) or False (warning), parameter, and text."""
    if mounting.camera is not None:
        yield from _axes(mounting, bag)
        yield from _focal_length(mounting, bag)
        yield from _magnitudes(mounting, bag)


def _axes(mounting: MeasuredMounting, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    if mounting.camera is not None and mounting.camera.axes.text:
        text = (
            f"{mounting.section}.camera: stars on '{mounting.topic}' in {bag.path} fit the sky only in a mirrored "
            f"image: {mounting.camera.axes.text}; expected u to the right and v down, looking out of the sensor"
        )
        yield True, f"{mounting.section}.camera", text


def _focal_length(mounting: MeasuredMounting, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    camera, configured_m = mounting.camera, mounting.device.camera.focal_length_m
    if camera is None or camera.focal_length_m is None:
        return
    name, pitch_m = f"{mounting.section}.camera.focal_length_m", mounting.device.camera.pixel_pitch_m
    start = f"parameter '{name}' = {configured_m:g} m, but angles between stars on '{mounting.topic}' in {bag.path}"
    off = camera.focal_length_m / configured_m - 1.0
    if not abs(off) <= _FOCAL_LENGTH_TOLERANCE:
        yield True, name, f"{start} are those of {camera.focal_length_m:.4g} m with pixels of {pitch_m:g} m"
        return
    least = _ACCEPTED_SIGMAS * mounting.device.camera.focal_sigma
    if camera.optics is not None and abs(off) > max(_SIGMAS * camera.optics.scale_sigma, least):
        sigma_m = camera.optics.scale_sigma * configured_m
        text = (
            f"{start} are those of {camera.focal_length_m:.6g} m, sigma {sigma_m:.1g} m, with pixels of {pitch_m:g} m: "
            f"{100.0 * off:+.3f} %"
        )
        yield False, name, text


def _magnitudes(mounting: MeasuredMounting, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    magnitudes = None if mounting.camera is None else mounting.camera.magnitudes
    if magnitudes is None or abs(magnitudes.offset) <= max(_OTHER_BAND, _OFFSET_SIGMAS * magnitudes.sigma):
        return
    side = "fainter" if magnitudes.offset > 0.0 else "brighter"
    text = (
        f"{mounting.section}: magnitudes of stars on '{mounting.topic}' in {bag.path} are {abs(magnitudes.offset):.2f} "
        f"{side} than the catalogue's (Hp), sigma {magnitudes.sigma:.2f}: instrumental, or of another band; "
        f"subtract {magnitudes.offset:.2f}, or give NaN"
    )
    yield False, mounting.section, text
