"""The terminal view: the same essentials as the page, over ssh at 80 columns by 24 rows.

A picture becomes lines of text by pure functions (``pen``, ``screen``, ``details``); only ``app`` knows textual. It
draws what :mod:`ship_watch` has decided, in the colours of the page, and knows no ROS.
"""
