"""Bags: MCAP files and rosbag2 folders read, written, walked, recovered, recorded and played; ship logs read into them.

The flat modules are what every file and message needs: errors, stamps, names of topics, messages made and decoded. The
rooms are :mod:`mcap`, :mod:`rosbag2`, :mod:`live`, :mod:`nmea` and :mod:`commands`. Of this suite only geometry is
known here.
"""
