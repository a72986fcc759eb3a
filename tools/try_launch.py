"""Starts suite.launch.xml with a missing suite file: each node must end with an error. Needs launch_ros.

Exit code 0 all ended with exit code 2; 1 a node started with its defaults; 2 launch_ros is not installed.
"""

import sys
import threading
from pathlib import Path

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser

LAUNCH_FILE = Path(__file__).resolve().parents[1] / "src" / "ship_bringup" / "launch" / "suite.launch.xml"
NODES = "star_attitude", "ship_attitude", "optical_axis", "triangulation", "nmea_out", "nmea_in"
LONGEST_S = 120.0
"""Maximum duration, s, for six nodes that start six times each on a busy machine."""


def main() -> int:
    """Run the launch file."""
    CommandParser(prog="try_launch", description=__doc__).parse_args()
    try:
        import launch_ros  # noqa: F401 - adds nodes to launch files
        from launch import LaunchDescription, LaunchService
        from launch.actions import IncludeLaunchDescription, RegisterEventHandler
        from launch.event_handlers import OnProcessExit
        from launch.launch_description_sources import AnyLaunchDescriptionSource
    except ImportError as error:
        print(f"try_launch: {error}: source an installation of ROS 2 Jazzy first", file=sys.stderr)
        return EXIT_BAD_INPUT
    codes: dict[str, list[int]] = {}

    def note(event, _context) -> None:
        codes.setdefault(Path(event.cmd[0]).name, []).append(event.returncode)

    arguments = [("file", "/nosuch/suite.yaml"), *((node, "true") for node in NODES)]
    suite = IncludeLaunchDescription(AnyLaunchDescriptionSource(str(LAUNCH_FILE)), launch_arguments=arguments)
    service = LaunchService()
    service.include_launch_description(LaunchDescription([RegisterEventHandler(OnProcessExit(on_exit=note)), suite]))
    end = threading.Timer(LONGEST_S, service.shutdown)
    end.start()
    service.run()
    end.cancel()
    wrong = [node for node in NODES if set(codes.get(node, [])) != {EXIT_BAD_INPUT}]
    print(f"try_launch: {'these did not end: ' + ', '.join(wrong) if wrong else 'each node ended with exit code 2'}")
    return EXIT_BOUND_NOT_MET if wrong else EXIT_DONE


if __name__ == "__main__":
    sys.exit(main())
