"""Detection of trouble, when the status of an estimator is worse than its inputs allow or a source is excluded."""

from ship_geometry.earth.time_scales import SECOND_NS

ENDS_AFTER_NS = 30 * SECOND_NS
"""Time without a sign of trouble after which trouble ends, ns."""


class TroubleDetector:
    """Start and end of trouble, from signs that are checked once a second.

    Args:
        after_s: duration of uninterrupted signs after which trouble begins, s.

    Attributes:
        first_sign_ns: time of the first sign; None without a sign in the last 30 s.
        began_ns: time at which trouble began; None without trouble.

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
        """Update with a sign of trouble, or its absence, at a time."""
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
