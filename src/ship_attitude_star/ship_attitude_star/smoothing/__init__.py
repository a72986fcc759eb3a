"""Smoothing: what later measurements tell of the attitude at earlier moments (Rauch, Tung and Striebel).

No ROS, no files.
"""
