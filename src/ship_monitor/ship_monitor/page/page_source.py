"""Source of the page's data: a running suite or a bag.

All browsers share the source of a running suite. For a bag each browser has its own source, because each browser
displays its own time.
"""

from collections.abc import Callable
from typing import Protocol

from bokeh.models.ui import UIElement

from ship_watch.history.history import History
from ship_watch.suite_state import SuiteStateSource


class PageSource(SuiteStateSource, Protocol):
    """Interface of the page to a running suite or a bag."""

    @property
    def history(self) -> History:
        """Data of the plots."""
        ...

    def controls(self, on_move: Callable[[], None]) -> UIElement | None:
        """Return new controls to be placed under the top bar, such as the time slider of a bag; None for no controls.

        Args:
            on_move: called after the controls have changed the displayed time; the page then updates.
        """
        ...
