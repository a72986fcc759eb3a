"""The live page: colours, the first screenful, the panels below it, and the server that serves them.

It draws what :mod:`ship_watch` has decided and judges nothing anew. It knows Bokeh, and no ROS.
"""
