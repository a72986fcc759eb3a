"""What a source says after a jump is in doubt until lights of two moments have agreed with it.

The estimate is opened for a jump, so that the first lights after it find where the source is now, whatever it does.
Only those of another moment tell whether it goes on from there: a source that stands still while the telescope turns,
or whose axis does not follow, agrees with none but the first.
"""

from typing import NamedTuple


class Unconfirmed(NamedTuple):
    """A jump that lights have not confirmed yet.

    Attributes:
        since_ns: lights after this stamp count.
        why: what is in doubt, in words.
        agreed_ns: stamp of the first lights that agreed; None before.
    """

    since_ns: int
    why: str
    agreed_ns: int | None = None

    def after_lights(self, time_ns: int) -> "Unconfirmed | None":
        """What is left of the doubt after lights at a moment have agreed; None for nothing.

        >>> doubt = Unconfirmed(10, "the encoders have jumped")
        >>> doubt.after_lights(10) is doubt, doubt.after_lights(20).agreed_ns, doubt.after_lights(20).after_lights(30)
        (True, 20, None)
        """
        if time_ns <= self.since_ns or time_ns == self.agreed_ns:
            return self
        return self._replace(agreed_ns=time_ns) if self.agreed_ns is None else None

    @property
    def text(self) -> str:
        """In words."""
        return f"{self.why}, and lights of two moments have not confirmed it since"
