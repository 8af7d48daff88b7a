"""A simulated gyro: takes commands, advances device time, gives recorded rows. Carrier level or slow flow, one interface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device import Device
from ..errors import DeviceError
from ..jit import say_if_uncompiled
from ..recording.command import Command
from .loops import initial_loop_state, loop_parameters, supported_modes
from .plant import CarrierPlant, Plant, SlowFlowPlant
from .thermal import TemperatureWander
from .truth import Truth, operating_point, truth_of

__all__ = ["GyroSimulator"]

FloatArray = NDArray[np.float64]
#: device seconds simulated per kernel call: bounds the memory of the noise samples
_CHUNK_S = {"carrier": 0.25, "slow_flow": 2.0}


@dataclass(frozen=True)
class _Clock:
    """Bookkeeping of rows: how many were made, how long one is, how far its centre lies behind."""

    row_s: float
    delay_s: float

    def times(self, first: int, count: int) -> FloatArray:
        return np.asarray(np.arange(first + 1, first + count + 1) * self.row_s - self.delay_s)


class GyroSimulator:
    """Simulate a device under commands.

    Parameters
    ----------
    device : Device
        The true device.
    rng : numpy.random.Generator
        Source of all noise.
    fidelity : {"carrier", "slow_flow"}
        Every converter sample, or theory.md Eq. 3 at the control rate.
    noisy : bool
        False switches off every noise and the temperature wander (closed-form checks).

    Notes
    -----
    Starts in ``Command()`` (``ftr_x``) at its steady state. Rows are time-stamped at the centre of the filter kernel.
    """

    def __init__(self, device: Device, *, rng: np.random.Generator, fidelity: str = "carrier", noisy: bool = True) -> None:
        if fidelity not in ("carrier", "slow_flow"):
            raise DeviceError(f"Argument fidelity must be 'carrier' or 'slow_flow', but got {fidelity!r}.")
        say_if_uncompiled()
        self._device = device
        self._command = Command()
        self._segment = 0
        self._rows_made = 0
        # each noise has its own stream, so that the rows do not depend on how the calls divide the time
        self._wander = TemperatureWander(device.environment, np.random.default_rng(rng.integers(0, 2**63, size=4)), noisy=noisy)
        kind: type[Plant] = CarrierPlant if fidelity == "carrier" else SlowFlowPlant
        start = operating_point(device, self._command, 0.0)
        self._plant = kind(device, rng, initial_loop_state(device, self._command, start), start, noisy=noisy)
        self._plant.param[:] = loop_parameters(device, self._command)
        self._chunk_s = _CHUNK_S[fidelity]
        self._clock = _Clock(1.0 / device.electronics.sample_rate_hz, self._plant.row_delay_s)

    @property
    def device_id(self) -> str:
        """Identity of the unit."""
        return self._device.device_id

    @property
    def factory(self) -> dict[str, Any]:
        """What left the factory with the unit."""
        return self._device.factory()

    @property
    def sample_rate_hz(self) -> float:
        """Rows per second of device time [Hz]."""
        return self._device.electronics.sample_rate_hz

    @property
    def time_s(self) -> float:
        """Device time [s]."""
        return self._rows_made * self._clock.row_s

    @property
    def command(self) -> Command:
        """Command in force."""
        return self._command

    @property
    def segment(self) -> int:
        """Number of the segment in force."""
        return self._segment

    def configure(self, command: Command) -> int:
        """Put a command in force from the next control period on; returns the new segment number.

        Raises
        ------
        DeviceError
            A mode that this device's loops do not have.
        """
        if command.mode not in supported_modes():
            raise DeviceError(f"Mode must be one of {', '.join(supported_modes())} for this simulator, but got {command.mode!r}.")
        self._command = command
        self._plant.param[:] = loop_parameters(self._device, command)
        self._segment += 1
        return self._segment

    def advance(self, duration_s: float, rate_rad_s: ArrayLike = 0.0) -> FloatArray:
        """Simulate and return the rows, shape (n, 12), ``n`` = duration in whole rows.

        Parameters
        ----------
        duration_s : float
            Device time [s].
        rate_rad_s : float or ndarray
            Input rate; an array is spread evenly over the duration, held between its samples [rad/s].
        """
        count = round(duration_s / self._clock.row_s)
        if count <= 0:
            return np.zeros((0, 12))
        rates = np.atleast_1d(np.asarray(rate_rad_s, dtype=float))
        rates = rates[np.minimum((np.arange(count) * rates.size) // count, rates.size - 1)]
        chunk = max(1, round(self._chunk_s / self._clock.row_s))
        return np.concatenate([self._advance_rows(rates[i : i + chunk]) for i in range(0, count, chunk)])

    def _advance_rows(self, rates: FloatArray) -> FloatArray:
        count = rates.size
        temperature = self._wander.rows(self.time_s, count, self._clock.row_s)
        channels = self._plant.rows(rates, temperature)
        rows = np.empty((count, 12))
        rows[:, 0] = self._clock.times(self._rows_made, count)
        rows[:, 1] = self._segment
        rows[:, 2:10] = channels[:, :8]
        rows[:, 10] = channels[:, 8] / (2.0 * math.pi)
        rows[:, 11] = temperature
        self._rows_made += count
        return rows

    def truth(self, rate_rad_s: float = 0.0) -> Truth:
        """True bias and scale factor of ``rate_raw`` under the command in force, at the mean temperature.

        Hidden from every estimator; demo and tests compare with it.
        """
        return truth_of(self._device, self._command, rate_rad_s)
