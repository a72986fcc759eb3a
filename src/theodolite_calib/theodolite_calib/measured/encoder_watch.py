"""Is the encoder alive? Readings that stand still are watched against their own motion before, and the lights.

A theodolite at rest reads the same for hours, and one that is stuck does so too. What tells them apart are the lights:
when they say that the telescope has turned in the deck, the encoder is stuck. Until lights have confirmed it, readings
that stopped dead in the midst of a motion are in doubt.
"""

import numpy as np

from ship_estimation.jump_guard import JumpVerdict
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stuck_guard import StuckGuard, Witness
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.measured.encoder_jumps import EncoderJump, EncoderJumps
from theodolite_calib.measured.samples import EncoderSample

_LIGHTS = "lights"
_SIGMAS = 5.0

_LARGEST_ANGLE = 2.0 * np.pi + 1e-6
_SURE_AFTER = 20
"""Readings beyond a turn, in a row, after which a reading within it is not believed either."""


class EncoderWatch:
    """Watches the readings of one run in the order of their stamps.

    Args:
        sigma_rad: noise of a reading; an arcsecond where it is less.
        max_acceleration: that the mount can reach, rad/s².

    Attributes:
        jump: of the last reading checked, where the encoders have slipped and it is believed.
    """

    def __init__(self, sigma_rad: float, max_acceleration: float) -> None:
        self._guard = StuckGuard(sigma_rad)
        self._jumps = EncoderJumps(sigma_rad, max_acceleration)
        self.jump: EncoderJump | None = None
        self._unconfirmed: tuple[int, str] | None = None
        self._witnesses: dict[str, Witness] = {}
        self._last: tuple[EncoderSample, FloatArray] | None = None
        self._beyond_a_turn = 0
        self._still_since_ns: int | None = None
        self._in_doubt_since_ns: int | None = None
        self.reconfigure(sigma_rad, max_acceleration)

    def reconfigure(self, sigma_rad: float, max_acceleration: float) -> None:
        """Go on with another noise and another mount."""
        self._sigma_rad = max(sigma_rad, ARCSEC)
        self._guard.sigma_rad = self._sigma_rad
        self._jumps.reconfigure(self._sigma_rad, max_acceleration)

    @property
    def doubt(self) -> str:
        """Why the readings are in doubt until a light has confirmed them; empty where they are not."""
        if self._unconfirmed is not None:
            return f"{self._unconfirmed[1]}, and no light has confirmed them since"
        if self._in_doubt_since_ns is not None:
            return "the encoders stopped dead in a motion: at rest, or stuck"
        return ""

    def check_units(self, sample: EncoderSample) -> Refusal | None:
        """The refusal of a reading that cannot be in radians; after a run of such, of all until a reset."""
        azimuth, elevation = sample.vector.tolist()
        beyond = max(abs(azimuth), abs(elevation)) > _LARGEST_ANGLE
        sure = self._beyond_a_turn >= _SURE_AFTER
        if not beyond and not sure:
            self._beyond_a_turn = 0
            return None
        self._beyond_a_turn += beyond
        text = f"azimuth {azimuth:.6g}, elevation {elevation:.6g}: expected radians within a turn; degrees?"
        return Refusal(Reason.UNITS, text + " All readings are refused until a reset" * sure)

    def check(self, sample: EncoderSample, track: VectorTrack[EncoderSample]) -> Refusal | None:
        """The refusal of a reading; None where nothing is known against it.

        Args:
            sample: the reading.
            track: those taken so far; by these a reading is judged that comes after later ones.
        """
        if self._jumps.watched(sample.time_ns):
            self.jump = None
            text = self._jumps.refusal(sample, _before(track, sample.time_ns), self._guard.coarseness_rad)
            return Refusal(Reason.GATE, text) if text else None
        judged, self.jump, text = self._jumps.judge(sample, self._guard.coarseness_rad)
        if judged is JumpVerdict.REFUSED:
            return Refusal(Reason.GATE, text)
        if self.jump is not None:
            self._unconfirmed = self.jump.time_ns, "the encoders have jumped"
        self._watch_motion(sample)
        if self._guard.observe(sample.time_ns, sample.vector, self._witnesses):
            # Where they go on, nothing leads there.
            self._jumps.forget()
            self._unconfirmed = sample.time_ns, "the encoders were stuck"
            text = "both encoders stand still while the lights say that the telescope turns in the deck"
            return Refusal(Reason.STUCK, text)
        return None

    def see_lights(self, time_ns: int, telescope_dt: FloatArray, sigma_rad: float) -> None:
        """The telescope in the deck as lights had it at a moment, shape (3, 3), with the error about its worst axis."""
        # Before the readings stood still the telescope may well have turned.
        if self._still_since_ns is not None and time_ns >= self._still_since_ns:
            self._witnesses[_LIGHTS] = Witness(time_ns, telescope_dt, sigma_rad)

    def confirm(self, time_ns: int) -> None:
        """Lights at a moment agreed with the readings of that moment."""
        if self._in_doubt_since_ns is not None and time_ns > self._in_doubt_since_ns:
            self._in_doubt_since_ns = None
        if self._unconfirmed is not None and time_ns > self._unconfirmed[0]:
            self._unconfirmed = None

    def _watch_motion(self, sample: EncoderSample) -> None:
        """Doubt begins with a reading equal to the last one although that one had moved."""
        if self._last is None:
            self._last, self._still_since_ns = (sample, np.zeros(2)), sample.time_ns
            return
        last, rate = self._last
        step = sample.vector - last.vector
        step -= 2.0 * np.pi * np.round(step / (2.0 * np.pi))
        interval_s = (sample.time_ns - last.time_ns) * 1e-9
        if np.any(step):
            self._witnesses, self._still_since_ns, self._in_doubt_since_ns = {}, sample.time_ns, None
        elif np.max(np.abs(rate)) * interval_s > _SIGMAS * self._sigma_rad and self._in_doubt_since_ns is None:
            self._in_doubt_since_ns = sample.time_ns
        self._last = sample, step / interval_s


def _before(track: VectorTrack[EncoderSample], time_ns: int) -> list[EncoderSample]:
    """The two readings before a moment, as far as there are."""
    found: list[EncoderSample] = []
    while len(found) < 2:
        sample = track.last_before(time_ns - 1)
        if sample is None:
            break
        found.insert(0, sample)
        time_ns = sample.time_ns
    return found
