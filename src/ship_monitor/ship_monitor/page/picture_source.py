"""Where the page has its pictures from: a running suite, or a bag.

Of a running suite one source serves all browsers. Of a bag each browser has one of its own, because each looks at
another time.
"""

from collections.abc import Callable
from typing import Protocol

from bokeh.models.ui import UIElement

from ship_watch.history import History
from ship_watch.picture import Picture


class PictureSource(Protocol):
    """What the page asks of a running suite or of a bag."""

    @property
    def label(self) -> str:
        """Where the data are from, for the top bar: "LIVE", "BAG" or "SIMULATED", and what is to be added."""
        ...

    @property
    def name(self) -> str:
        """The ship: its namespace without slashes, or the name of the bag."""
        ...

    @property
    def place(self) -> str:
        """Where it looks, in words, for a page that is waiting: namespace and domain."""
        ...

    @property
    def history(self) -> History:
        """What the plots show."""
        ...

    def look(self) -> Picture:
        """The picture now. Each browser asks twice a second: a source that serves several keeps the last one."""
        ...

    def controls(self, moved: Callable[[], None]) -> UIElement | None:
        """What stands under the top bar, as the time slider of a bag, made anew for each browser; None for nothing.

        Args:
            moved: to be called where the controls have changed the picture, which is then looked at once more.
        """
        ...
