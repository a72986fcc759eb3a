"""Where the page has its pictures from: a running suite, or a bag.

Of a running suite one source serves all browsers. Of a bag each browser has one of its own, because each looks at
another time.
"""

from collections.abc import Callable
from typing import Protocol

from bokeh.models.ui import UIElement

from ship_watch.history import History
from ship_watch.picture import Pictures


class PictureSource(Pictures, Protocol):
    """What the page asks of a running suite or of a bag."""

    @property
    def history(self) -> History:
        """What the plots show."""
        ...

    def controls(self, moved: Callable[[], None]) -> UIElement | None:
        """What stands under the top bar, as the time slider of a bag, made anew for each browser; None for nothing.

        Args:
            moved: to be called where the controls have changed the picture, which is then looked at once more.
        """
        ...
