"""NMEA 0183 sentences as messages; import of ship logs into a bag.

The lines of a live instrument and of a log become the same messages. The folder imports the common modules of the
package and :mod:`ship_bags.mcap`, but not rclpy.
"""
