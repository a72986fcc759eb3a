"""In which order outputs go out, and when it is time to say that there are none: one rule for every estimator.

Two clocks are at work. Outputs are ordered by their stamps, the time of the data. Silence is measured in the time of
waiting, a clock that nobody sets and that the shell gives with each input and tick: stamps that are old, or a system
clock that is put right, are no silence.
"""

SECOND_NS = 1_000_000_000


class OutputOrder:
    """What has been put out so far.

    Outputs that claim something strictly increase in time. One that says INVALID carries the time of a tick, stands
    outside that order and holds none back.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """The clock jumped: outputs may start again at earlier times."""
        self._last_claim_ns: int | None = None
        self._silent_after_ns: int | None = None
        self._said_invalid_ns: int | None = None

    def follows(self, time_ns: int) -> bool:
        """Whether an output for a moment may still go out: it is later than all before."""
        return self._last_claim_ns is None or time_ns > self._last_claim_ns

    def claimed(self, time_ns: int, waiting_ns: int, patience_ns: int = SECOND_NS) -> None:
        """An output that claims something went out.

        Args:
            time_ns: its stamp.
            waiting_ns: the time of waiting.
            patience_ns: how long the next one may take; never less than a second.
        """
        self._last_claim_ns = time_ns
        self._silent_after_ns = waiting_ns + max(patience_ns, SECOND_NS)
        self._said_invalid_ns = None

    def invalid_due(self, waiting_ns: int) -> bool:
        """Whether to say INVALID now: no output for too long, and not yet said in the last second.

        Whoever asks and hears "yes" says it.
        """
        if self._silent_after_ns is not None and waiting_ns <= self._silent_after_ns:
            return False
        if self._said_invalid_ns is not None and waiting_ns - self._said_invalid_ns < SECOND_NS:
            return False
        self._said_invalid_ns = waiting_ns
        return True
