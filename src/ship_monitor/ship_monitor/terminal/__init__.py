"""The terminal view: the page's first screen over ssh, at 80 columns by 24 rows.

The modules ``styled_text`` and ``screen`` convert a state to lines of text; only ``app``, which adds the pages of
details and the keys, uses textual.
The state is computed in :mod:`ship_watch`; the colours are the same as on the page. No ROS is used.
"""
