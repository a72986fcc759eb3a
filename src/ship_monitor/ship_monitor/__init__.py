"""What people look at while a suite runs, or after: the live page, the terminal view, the node of the alerts.

What is shown is decided in :mod:`ship_watch`; here it is read from topics or bags, and drawn.
"""
