"""Detection of trouble: the status of an estimator is worse than its inputs allow, or a source of it is excluded."""

from ship_geometry.time_scales import SECOND_NS

ENDS_AFTER_NS = 30 * SECOND_NS
"""Trouble ends after so long without a sign of it, ns."""


class TroubleDetector:
    """When trouble begins and ends, by signs that are looked for once a second.

    Args:
        after_s: signs must last for so long.

    Attributes:
        first_sign_ns: time of the first sign; None where there was none in the last 30 s.
        began_ns: time at which the signs had lasted long enough; None where there is no trouble.

    Example:
        >>> detector = TroubleDetector(after_s=2.0)
        >>> for second, is_sign in enumerate((False, True, False, True, True, True)):
        ...     detector.update(second * SECOND_NS, is_sign)
        >>> detector.first_sign_ns // SECOND_NS, detector.began_ns // SECOND_NS
        (1, 5)
    """

    def __init__(self, after_s: float) -> None:
        self.after_ns = round(after_s * SECOND_NS)
        self.first_sign_ns: int | None = None
        self.began_ns: int | None = None
        self._lasts_since_ns: int | None = None
        self._last_sign_ns = 0

    def update(self, time_ns: int, is_sign: bool) -> None:
        """Take note of a sign of trouble, or of its absence, at a time."""
        if is_sign:
            if self.first_sign_ns is None:
                self.first_sign_ns = time_ns
            if self._lasts_since_ns is None:
                self._lasts_since_ns = time_ns
            self._last_sign_ns = time_ns
            if self.began_ns is None and time_ns - self._lasts_since_ns >= self.after_ns:
                self.began_ns = time_ns
            return
        self._lasts_since_ns = None
        if self.first_sign_ns is not None and time_ns - self._last_sign_ns >= ENDS_AFTER_NS:
            self.first_sign_ns = self.began_ns = None
