"""What a live node watches beside its inputs: that its name is its own, and that the log tells of errors once."""

from collections.abc import Iterable

from rclpy.node import Node

from ship_node.diagnostics import Level, Status
from ship_node.input_health import InputHealthBook


def name_status(node: Node) -> Status:
    """Whether a second node has this one's name: services and parameters then reach either, outputs are of both."""
    own = node.get_fully_qualified_name()
    names = [f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()]
    if (count := names.count(own)) <= 1:
        return Status("name", Level.OK, own)
    text = f"{count} nodes are called '{own}': end all but one, or name them apart with -r __node:=NAME"
    return Status("name", Level.ERROR, text)


def stamps_status(health: InputHealthBook) -> Status:
    """Whether any input's data are of another time; the diagnostics of that input say it too."""
    text = health.of_another_time()
    return Status("stamps", Level.ERROR, text) if text else Status("stamps", Level.OK, "of the node's time")


class ErrorLog:
    """Logs each error when it begins and when it is over, not as often as it is reported.

    Args:
        node: whose log.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._told: set[str] = set()

    def tells_of(self, name: str) -> bool:
        """Whether an error of that status was logged and is not over yet."""
        return name in self._told

    def note(self, statuses: Iterable[Status]) -> None:
        """Take the statuses as they are now."""
        for status in statuses:
            if status.level is Level.ERROR and status.name not in self._told:
                self._told.add(status.name)
                self._logger.error(f"{status.name}: {status.message}")
            elif status.level is not Level.ERROR and status.name in self._told:
                self._told.remove(status.name)
                self._logger.info(f"{status.name}: {status.message}")
