"""The one sender whose datagrams a source uses.

Two instruments, or an instrument and a datagram from elsewhere, would be mixed on one topic; attitudes stamped ahead by
the one make those of the other late. So the first sender that gives something is held until it is silent.
"""

from ship_bags.stamps import NS_PER_S

HELD_NS = 10 * NS_PER_S
"""Silence after which another sender may take the place of the one that is held, ns."""

NOT_LISTED = "sender that is not in 'from'"
NOT_HELD = "sender other than the first (name the instrument's address in 'from')"


class SenderRule:
    """Decides whose datagrams are used.

    Args:
        addresses: those allowed, whose ports do not matter then; empty for any address, and one port of it.

    Attributes:
        held: the sender in use; empty where there is none.
    """

    def __init__(self, addresses: tuple[str, ...]) -> None:
        self._addresses = addresses
        self.held = ""
        self._last_ns = 0

    def refusal(self, sender: str, now_ns: int) -> str:
        """Return why a text of a sender is not used; empty where it is.

        Args:
            sender: address and port, as ``10.0.0.7:4001``; empty for a stream, which has one sender alone.
            now_ns: steady time.
        """
        identity = self._identity(sender)
        if self._addresses and sender and identity not in self._addresses:
            return NOT_LISTED
        if self.held and now_ns - self._last_ns > HELD_NS:
            self.held = ""
        if self.held and identity != self.held:
            return NOT_HELD
        if self.held:
            self._last_ns = now_ns
        return ""

    def hold(self, sender: str, now_ns: int) -> None:
        """Hold a sender that gave what the source is for."""
        self.held, self._last_ns = self._identity(sender), now_ns

    def _identity(self, sender: str) -> str:
        return sender.rpartition(":")[0] if self._addresses else sender
