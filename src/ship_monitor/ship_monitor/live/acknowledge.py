"""Acknowledgement of an alert, by the service of the alert node."""

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from ship_msgs.srv import AcknowledgeAlert

SERVICE = "alerts/acknowledge"
"""Relative name of the service."""

_FOUND_WITHIN_S = 2.0
_ANSWERED_WITHIN_S = 3.0


def acknowledge(context: Context, namespace: str, alert_id: str, instance: int) -> str:
    """Acknowledge one instance of an alert; wait for the answer and return the result in words.

    The temporary node shares the context, and with it the DDS participant: two participants in one process can
    deadlock.

    Args:
        context: rclpy context of the reader's node.
        namespace: namespace of the suite.
        alert_id: id of the alert.
        instance: instance of the alert.
    """
    node = rclpy.create_node("acknowledge", namespace=namespace, context=context, use_global_arguments=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        client = node.create_client(AcknowledgeAlert, SERVICE)
        if not client.wait_for_service(timeout_sec=_FOUND_WITHIN_S):
            return f"not acknowledged: no service {client.service_name}; is the node alerts running?"
        answer = client.call_async(AcknowledgeAlert.Request(id=alert_id, instance=instance))
        executor.spin_until_future_complete(answer, timeout_sec=_ANSWERED_WITHIN_S)
        response = answer.result() if answer.done() else None
        if response is None:
            return f"not acknowledged: no answer of {client.service_name} within {_ANSWERED_WITHIN_S:.0f} s"
        if response.success:
            return str(response.message) or f"{alert_id} acknowledged"
        return f"not acknowledged: {response.message}"
    finally:
        executor.shutdown()
        node.destroy_node()
