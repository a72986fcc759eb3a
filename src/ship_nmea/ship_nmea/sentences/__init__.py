"""Sentences of NMEA 0183 (IEC 61162-1) from values, and commands of the bridge from sentences.

All is pure and knows no socket, no clock and no ROS. pynmea2 builds and reads them; what it lacks is defined here.
"""
