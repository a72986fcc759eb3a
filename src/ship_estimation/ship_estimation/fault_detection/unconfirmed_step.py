"""A step of a source is unconfirmed until other sources are consistent with this source at two different times.

The covariance is inflated for a step, so that the first measurement after the step determines the new value in any
case. Only a measurement at another time can confirm the step. A source that is frozen while the ship or the telescope
rotates, or whose axis does not follow, is consistent with the first measurement only.

The very first measurement is used with a prior that may be wide. This measurement is confirmed by the next consistent
measurement at another time or of another source.
"""

from typing import NamedTuple


class UnconfirmedStep(NamedTuple):
    """A step that other sources have not confirmed yet.

    Attributes:
        since_ns: stamp after which measurements may confirm the step.
        why: text that names what is unconfirmed.
        confirming: text that names the confirming sources, for example stars or lights.
        confirmed_ns: stamp of the first consistent measurement; None before that measurement.
        confirmed_by: source of that measurement, if another source may confirm the step at the same time; empty if only
            another time counts.
    """

    since_ns: int
    why: str
    confirming: str
    confirmed_ns: int | None = None
    confirmed_by: str = ""

    def with_confirmation(self, time_ns: int, source: str = "") -> "UnconfirmedStep | None":
        """Return the step after a consistent measurement of a source; None if the step is confirmed now.

        >>> step = UnconfirmedStep(10, "the encoders have jumped", "lights")
        >>> step.with_confirmation(10) is step, step.with_confirmation(20).confirmed_ns
        (True, 20)
        >>> step.with_confirmation(20).with_confirmation(30) is None
        True

        Another source may confirm the step at the same time:

        >>> first = UnconfirmedStep(9, "one exposure alone", "stars", confirmed_ns=10, confirmed_by="star.fore")
        >>> first.with_confirmation(10, "star.fore") is first, first.with_confirmation(10, "star.aft")
        (True, None)
        """
        is_other_source = self.confirmed_by not in ("", source)
        if time_ns <= self.since_ns or (time_ns == self.confirmed_ns and not is_other_source):
            return self
        return self._replace(confirmed_ns=time_ns) if self.confirmed_ns is None else None

    @property
    def text(self) -> str:
        """Text of an unconfirmed step."""
        of = "another time or sensor" if self.confirmed_by else "two different times"
        return f"{self.why}; confirmation by {self.confirming} of {of} is pending"
