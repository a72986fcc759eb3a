"""Bags and the live network: topics recorded into a bag, a bag played onto topics with /clock.

Besides this folder only the commands that use it import rclpy. It imports the common modules of the package and
:mod:`ship_bags.mcap`.
"""
