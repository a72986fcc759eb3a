"""Playback of a bag or a black box on the page.

The monitored messages are read into a :class:`ship_watch.suite_monitor.SuiteMonitor`. Bokeh widgets set the displayed
time. No ROS is used.
"""
