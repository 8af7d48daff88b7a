"""Thin ROS 2 nodes: messages, parameters, services; the work is done by the packages beside this one."""

from ..threads import one_thread

# here, because the nodes load numpy with their messages
one_thread()
