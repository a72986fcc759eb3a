"""Topics of a running suite, read at the rate of the display.

Only this folder of the package creates subscriptions. It imports rclpy, and no other folder of the package.
"""
