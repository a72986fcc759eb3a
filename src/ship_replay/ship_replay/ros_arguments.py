"""A command line's own arguments apart from those for ROS."""

from collections.abc import Sequence


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The command's own arguments, and those between ``--ros-args`` and ``--`` (or the end), as rclpy.init takes them.

    rclpy's own function would also take away whatever looks like a remap rule, as ``--remap OLD:=NEW`` of `play`.
    """
    own: list[str] = []
    ros: list[str] = []
    taken = own
    for argument in arguments:
        if argument == "--ros-args":
            taken = ros
        if argument == "--" and taken is ros:
            taken = own
            continue
        taken.append(argument)
    return own, ros
