"""Sentences of NMEA 0183 (IEC 61162-1) from values, and commands of the bridge from sentences.

All functions are pure, without sockets, clock or ROS. pynmea2 builds and parses the sentences; sentences that pynmea2
lacks are defined here.
"""
