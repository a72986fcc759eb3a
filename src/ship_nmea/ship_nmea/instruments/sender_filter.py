"""Selection of the one sender whose datagrams a source uses.

Datagrams of two instruments, or of an instrument and of a foreign host, would be mixed on one topic. If the
clock of one sender is ahead, the attitudes of the other sender would be too late. The first sender with usable data is
therefore selected until it times out.
"""

from ship_bags.stamps import NS_PER_S

SENDER_TIMEOUT_NS = 10 * NS_PER_S
"""Time without a text of the selected sender after which another sender may be selected, ns."""

NOT_LISTED = "sender that is not in 'from'"
NOT_SELECTED = "sender other than the first (name the instrument's address in 'from')"


class SenderFilter:
    """Selects the sender whose datagrams are used.

    Args:
        addresses: allowed addresses, each with any port; if empty, one port of any address is selected.

    Attributes:
        selected: the selected sender; empty if no sender is selected.
    """

    def __init__(self, addresses: tuple[str, ...]) -> None:
        self._addresses = addresses
        self.selected = ""
        self._last_ns = 0

    def rejection_reason(self, sender: str, now_ns: int) -> str:
        """Return why a text of a sender is rejected; empty if the text is used.

        A text of the selected sender restarts the timeout of the selection.

        Args:
            sender: address and port, for example ``10.0.0.7:4001``; empty for a stream, which has one sender.
            now_ns: steady time.
        """
        identity = self._identity(sender)
        if self._addresses and sender and identity not in self._addresses:
            return NOT_LISTED
        if self.selected and now_ns - self._last_ns > SENDER_TIMEOUT_NS:
            self.selected = ""
        if self.selected and identity != self.selected:
            return NOT_SELECTED
        if self.selected:
            self._last_ns = now_ns
        return ""

    def select(self, sender: str, now_ns: int) -> None:
        """Select a sender whose data are usable."""
        self.selected, self._last_ns = self._identity(sender), now_ns

    def _identity(self, sender: str) -> str:
        return sender.rpartition(":")[0] if self._addresses else sender
