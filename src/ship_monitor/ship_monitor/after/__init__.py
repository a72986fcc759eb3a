"""Playback of a bag or a black box on the page: its monitored messages, and the displayed time.

It reads bags into a :class:`ship_watch.suite_monitor.SuiteMonitor`. It uses Bokeh widgets for the time, and no ROS.
"""
