"""Bags and the live network: recording of topics into a bag, and playing of a bag with /clock.

Only this folder and the commands that use it import rclpy. The folder imports the common modules of the package and
:mod:`ship_bags.mcap`.
"""
