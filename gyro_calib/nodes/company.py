"""One calibration node and one stream to a gyro: who else is there, as far as discovery knows."""

from __future__ import annotations

from rclpy.node import Node

from ..errors import DataError

__all__ = ["refuse_company"]


def refuse_company(node: Node, channels: str) -> None:
    """Refuse to command a gyro that somebody else can calibrate too, or whose topic two drivers publish.

    What died a moment ago still counts until discovery forgets it. Two nodes that have not found each other yet both begin; the first
    command of the later one then ends the run of the other (:class:`.ros_instrument.RosInstrument` looks at the segment).

    Parameters
    ----------
    node : rclpy.node.Node
        The calibration node.
    channels : str
        Full name of the topic of blocks that it hears.

    Raises
    ------
    DataError
        There is company; the text names it.
    """
    name = node.get_fully_qualified_name()
    namesakes = node.get_node_names_and_namespaces().count((node.get_name(), node.get_namespace()))
    if namesakes > 1:
        raise DataError(f"One node must calibrate a gyro, but {namesakes} are named {name}. Stop the others and wait 30 s.")
    if others := _other_calibrators(node, channels, name):
        raise DataError(f"One node must calibrate a gyro, but {', '.join(others)} can too. Stop the others and wait 30 s.")
    if (streams := node.count_publishers(channels)) > 1:
        raise DataError(f"One gyro must publish {channels}, but {streams} do. Give each gyro a namespace of its own.")


def _other_calibrators(node: Node, channels: str, name: str) -> list[str]:
    """Nodes of other names that hear this gyro and offer to calibrate it."""
    heard_by = {f"{found.node_namespace.rstrip('/')}/{found.node_name}" for found in node.get_subscriptions_info_by_topic(channels)}
    services = {service for service, _ in node.get_service_names_and_types()}
    return sorted(other for other in heard_by - {name} if f"{other}/self_calibrate" in services)
