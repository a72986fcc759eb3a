"""Smoothing: what later sightings tell of the pointing at earlier moments (Rauch, Tung and Striebel).

No ROS, no files.
"""
