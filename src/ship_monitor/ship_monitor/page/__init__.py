"""The live page: first screen, panels, playback of a bag, and server.

The page displays the state computed in :mod:`ship_watch`. It uses Bokeh, and no ROS.
"""
