"""Is the INS to be believed? Where the ship's attitude is that of the INS alone, its samples are watched as they come.

Its rates only judge the attitudes and are judged by them: the pointing rests on the attitudes, and no rate, true or
not, can spoil it. After a jump that was believed, pointings are in doubt until lights have confirmed one.
"""

from ship_estimation.ins import GuardedInsConfig
from ship_estimation.ins_guard import InsGuard, JudgedIns
from ship_estimation.refusals import same_stamp
from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.measured.samples import ShipSample


class ShipWatch:
    """Watches the INS's samples of one run in the order of their stamps.

    Args:
        config: the INS.
    """

    def __init__(self, config: GuardedInsConfig) -> None:
        self._guard = InsGuard(config)
        # With their rates: by these one is judged that comes after later ones.
        self._taken = AttitudeTrack(round(config.max_gap_s * SECOND_NS))
        self._unconfirmed_ns: int | None = None

    def reconfigure(self, config: GuardedInsConfig) -> None:
        """Go on with another noise."""
        self._guard.reconfigure(config)

    def judge(self, sample: ShipSample) -> JudgedIns:
        """What is to be done with a sample."""
        judged = self._guard.judge(sample, self._taken, {})
        if judged.rates_wrong_after_ns is not None:
            self._taken.forget_rates(judged.rates_wrong_after_ns)
        if judged.refusal is None:
            known = self._taken.get(sample.time_ns)
            if known is None or same_stamp(known, judged.sample)[0]:
                self._taken.insert(judged.sample)
        return judged

    def jumped(self, time_ns: int) -> None:
        """The INS has jumped just after a moment, and is believed."""
        self._unconfirmed_ns = time_ns

    def confirm(self, time_ns: int) -> None:
        """Lights at a moment agreed with the attitude of that moment."""
        if self._unconfirmed_ns is not None and time_ns > self._unconfirmed_ns:
            self._unconfirmed_ns = None

    def doubt(self, time_ns: int) -> str:
        """Why the attitude of a moment is in doubt; empty where it is not."""
        jumped = self._unconfirmed_ns is not None and time_ns > self._unconfirmed_ns
        return "the INS has jumped, and no light has confirmed it since" if jumped else ""

    def drop_before(self, time_ns: int) -> None:
        """Forget what no sample at or after ``time_ns`` is judged by."""
        self._taken.drop_before(time_ns)
