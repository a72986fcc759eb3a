"""What a live node watches beside its inputs: that its name is its own, and its data of its own time."""

from rclpy.node import Node

from ship_node.edge.input_health import InputHealthBook
from ship_node.edge.messages_out import DiagnosticStatus, Level


def name_status(node: Node) -> DiagnosticStatus:
    """Whether a second node has this one's name: services and parameters then reach either, outputs are of both."""
    own = node.get_fully_qualified_name()
    names = [f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()]
    if (count := names.count(own)) <= 1:
        return DiagnosticStatus("name", Level.OK, own)
    text = f"{count} nodes are called '{own}': end all but one, or name them apart with -r __node:=NAME"
    return DiagnosticStatus("name", Level.ERROR, text)


def stamps_status(health: InputHealthBook) -> DiagnosticStatus:
    """Whether any input's data are of another time; the diagnostics of that input say it too."""
    text = health.of_another_time()
    if not text:
        return DiagnosticStatus("stamps", Level.OK, "of the node's time")
    return DiagnosticStatus("stamps", Level.ERROR, text)
