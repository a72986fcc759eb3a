"""What a source says after a jump is in doubt until others have agreed with it at two moments.

The estimate is opened for a jump, so that the first measurement after it finds where the source is now, whatever it
does. Only one of another moment tells whether it goes on from there: a source that stands still while the ship or the
telescope turns, or whose axis does not follow, agrees with none but the first.

The first measurement of all is used by a prior that may be wide. It is confirmed by the next one that agrees with it,
of another time or of another source.
"""

from typing import NamedTuple


class Unconfirmed(NamedTuple):
    """A jump that others have not confirmed yet.

    Attributes:
        since_ns: what they measure after this stamp counts.
        why: what is in doubt, in words.
        by: who may confirm it, in words: stars, lights.
        agreed_ns: stamp of the first measurement that agreed; None before.
        agreed_by: source of that measurement, where another source confirms it at the same time as well; empty where
            only another time counts.
    """

    since_ns: int
    why: str
    by: str
    agreed_ns: int | None = None
    agreed_by: str = ""

    def after_agreement(self, time_ns: int, source: str = "") -> "Unconfirmed | None":
        """Return what is still unconfirmed after a consistent measurement of a source; None where nothing is.

        >>> doubt = Unconfirmed(10, "the encoders have jumped", "lights")
        >>> doubt.after_agreement(10) is doubt, doubt.after_agreement(20).agreed_ns
        (True, 20)
        >>> doubt.after_agreement(20).after_agreement(30) is None
        True
        >>> first = Unconfirmed(9, "one exposure alone", "stars", agreed_ns=10, agreed_by="star.fore")
        >>> first.after_agreement(10, "star.fore") is first, first.after_agreement(10, "star.aft")
        (True, None)
        """
        is_other_source = self.agreed_by not in ("", source)
        if time_ns <= self.since_ns or (time_ns == self.agreed_ns and not is_other_source):
            return self
        return self._replace(agreed_ns=time_ns) if self.agreed_ns is None else None

    @property
    def text(self) -> str:
        """In words."""
        of = "another time or sensor" if self.agreed_by else "two moments"
        return f"{self.why}, and {self.by} of {of} have not confirmed it since"
