"""Smoothing: pointings at earlier times, improved by later sightings (Rauch, Tung and Striebel).

The folder uses no ROS and no files.
"""
