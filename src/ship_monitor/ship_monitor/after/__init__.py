"""A bag or a black box, looked at after the fact: what of it is watched, and the time that is looked at.

It reads bags and gives them to a watch; it knows the widgets of Bokeh that choose the time, and no ROS.
"""
