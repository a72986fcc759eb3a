"""Smoothing: pointings at earlier times, improved by later sightings (Rauch, Tung and Striebel).

No ROS, no files.
"""
