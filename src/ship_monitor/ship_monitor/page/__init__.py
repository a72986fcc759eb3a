"""The live page: colours, first screen, panels below it, and their server.

It draws the state computed in :mod:`ship_watch`. It uses Bokeh, and no ROS.
"""
