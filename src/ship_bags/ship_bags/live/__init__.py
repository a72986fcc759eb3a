"""Bags and the live network: topics recorded into a bag, a bag played onto topics with /clock.

This is the only room of the package that imports rclpy. It imports the flat modules and :mod:`ship_bags.mcap`; of the
other rooms only the commands import it.
"""
