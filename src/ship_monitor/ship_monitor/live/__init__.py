"""Topics of a running suite, read at the rate of the display.

Only this folder of the package subscribes to topics. It imports rclpy and the live modules of ship_bags, and no other
folder.
"""
