"""Bags and the live network: topics recorded into a bag, a bag played onto topics with /clock.

This is the only room of the package that imports rclpy. It may import every other room but the commands.
"""
