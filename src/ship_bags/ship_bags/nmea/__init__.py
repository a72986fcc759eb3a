"""NMEA 0183 sentences as messages.

The lines of a live instrument and of a log become the same messages. The folder imports the common modules of the
package, but not rclpy.
"""
