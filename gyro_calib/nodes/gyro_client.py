"""The parameter services of a gyro's driver, called from a worker thread of a node that something else spins."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python

from ..errors import DataError, ExperimentAborted

__all__ = ["GyroClient", "parse_facts"]


class GyroClient:
    """Gets and sets the parameters of a gyro.

    Parameters
    ----------
    node : rclpy.node.Node
        Node that carries the service clients; its executor must run in another thread than the caller's.
    gyro : str
        Name of the gyro's node, relative to the namespace of ``node``.
    timeout_s : float
        Steady time that the gyro has to answer [s].
    """

    def __init__(self, node: Any, gyro: str = "gyro_sim", *, timeout_s: float = 10.0) -> None:
        self._timeout_s = timeout_s
        self._get = node.create_client(GetParameters, f"{gyro}/get_parameters")
        self._set = node.create_client(SetParametersAtomically, f"{gyro}/set_parameters_atomically")

    def get(self, names: Sequence[str]) -> dict[str, Any]:
        """Values by name.

        Raises
        ------
        ExperimentAborted
            The gyro is not there or does not answer.
        DataError
            The gyro does not have one of them.
        """
        response = self._call(self._get, GetParameters.Request(names=list(names)))
        values = dict(zip(names, map(parameter_value_to_python, response.values), strict=False))
        missing = [name for name in names if values.get(name) is None]
        if missing:
            raise DataError(f"Gyro driver must have the parameters {', '.join(names)}, but got no {', '.join(missing)}. Update the driver.")
        return values

    def set(self, values: Mapping[str, Any], *, timeout_s: float | None = None) -> None:
        """Set all of ``values`` or none; ``timeout_s`` overrides the usual patience [s].

        Raises
        ------
        ExperimentAborted
            The gyro is not there or does not answer.
        DataError
            The gyro refuses; the text is its reason.
        """
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self._call(self._set, SetParametersAtomically.Request(parameters=parameters), timeout_s).result
        if not result.successful:
            raise DataError(f"Gyro driver must take the command, but refused: {result.reason}")

    def _call(self, client: Any, request: Any, timeout_s: float | None = None) -> Any:
        timeout_s = self._timeout_s if timeout_s is None else timeout_s
        deadline = time.monotonic() + timeout_s
        while not client.service_is_ready():
            if time.monotonic() > deadline:
                raise ExperimentAborted(
                    f"Gyro must offer the service {client.service_name}, but nobody does after {timeout_s:g} s. "
                    "Start its driver or gyro_sim in this namespace, and check ROS_DOMAIN_ID."
                )
            time.sleep(0.02)
        future = client.call_async(request)
        answered = threading.Event()
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(deadline - time.monotonic(), 0.1 * timeout_s)):
            client.remove_pending_request(future)
            raise ExperimentAborted(
                f"Gyro must answer {client.service_name} within {timeout_s:g} s, but did not. Check that its driver still runs."
            )
        return future.result()


def parse_facts(values: Mapping[str, Any]) -> tuple[str, dict[str, Any], float]:
    """Device id, factory data and sample rate [Hz] from the driver's parameters.

    Raises
    ------
    DataError
        One of them is unusable.
    """
    device_id, rate_hz = str(values["device_id"]), float(values["sample_rate_hz"])
    if not device_id:
        raise DataError("Parameter device_id of the gyro must be a name, but got ''. Give each unit its own.")
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        raise DataError(f"Parameter sample_rate_hz of the gyro must be > 0, but got {rate_hz!r}. Correct it in the driver.")
    try:
        factory = json.loads(values["factory"])
    except ValueError as error:
        raise DataError(f"Parameter factory of the gyro must be JSON, but got {values['factory']!r} ({error}).") from error
    if not isinstance(factory, dict):
        raise DataError(f"Parameter factory of the gyro must be a JSON object, but got {values['factory']!r}.")
    return device_id, factory, rate_hz
