"""Results of the plausibility checks of INS samples (:mod:`ship_estimation.plausibility.ins_check`)."""

from typing import NamedTuple

from ship_estimation.plausibility.ins_jump import InsJump
from ship_estimation.plausibility.integrated_rates import StampArray
from ship_estimation.plausibility.motion_check import MotionReference
from ship_estimation.rejection_rules import Rejection
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, ExtraNoise


class CheckedInsSample(NamedTuple):
    """Result of the checks of a sample.

    Attributes:
        sample: sample to use, without its rate if the rates are not usable.
        rejection: reason not to use ``sample``, for example a step or drift detected with the sample; None if the
            sample is to be used.
        jumps: jump or drift of the attitude that is found with this sample; empty without one. A step against the rates
            is given at each end of the interval in which the step may have happened.
        rates_wrong_after_ns: stamp after which the rates of earlier samples were wrong; None without new information.
        noise: excess noise of the samples as estimated with this sample; None without new information.
    """

    sample: AttitudeSample
    rejection: Rejection | None = None
    jumps: tuple[InsJump, ...] = ()
    rates_wrong_after_ns: int | None = None
    noise: ExtraNoise | None = None


class CheckedBlock:
    """The leading samples of a block that were checked together.

    Attributes:
        count: number of checked samples.
        last: result for the last checked sample if it shows a drift, wrong rates or new excess noise; None otherwise.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last: CheckedInsSample | None = None
        self._pieces: list[_Piece] = []

    @property
    def accepted_count(self) -> int:
        """Number of leading samples that are accepted unchanged."""
        return self.count - (self.last is not None)

    def add(self, times_ns: StampArray, rotations: FloatArray, drift_rad_per_s: float) -> None:
        """Add checked stamps, attitudes by integrated rates, shape (N, 3, 3), and bound of the rate drift."""
        self._pieces.append(_Piece(self.count, times_ns, rotations, drift_rad_per_s))
        self.count += len(times_ns)

    def by_rates(self, number: int) -> MotionReference:
        """Return the attitude by integrated rates at a sample, as motion reference for the checks of other sources."""
        piece = self._pieces[-1]
        for piece in reversed(self._pieces):
            if piece.start <= number:
                break
        place = number - piece.start
        return MotionReference(int(piece.times_ns[place]), piece.rotations[place], 0.0, piece.drift_rad_per_s)


class _Piece(NamedTuple):
    """Samples from the number ``start`` on, with the arguments of :meth:`CheckedBlock.add`."""

    start: int
    times_ns: StampArray
    rotations: FloatArray
    drift_rad_per_s: float
