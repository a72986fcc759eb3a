"""Source of the page's data: a running suite or a bag.

One source of a running suite serves all browsers. For a bag each browser has its own, because each has its own time.
"""

from collections.abc import Callable
from typing import Protocol

from bokeh.models.ui import UIElement

from ship_watch.history import History
from ship_watch.suite_state import SuiteStateSource


class PageSource(SuiteStateSource, Protocol):
    """Interface of a running suite or a bag for the page."""

    @property
    def history(self) -> History:
        """Data of the plots."""
        ...

    def controls(self, on_move: Callable[[], None]) -> UIElement | None:
        """Return new controls for the place under the top bar, as the time slider of a bag; None for none.

        Args:
            on_move: called after the controls have changed the displayed time; the page then updates.
        """
        ...
