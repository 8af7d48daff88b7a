"""A simulated gyro: takes commands, advances device time, gives recorded rows. Carrier level or slow flow, one interface."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device import Device
from ..errors import DeviceError
from ..jit import say_if_uncompiled
from ..recording.command import Command
from .loops import check_command, hand_over, initial_loop_state, loop_parameters
from .plant import CarrierPlant, Plant, SlowFlowPlant
from .thermal import TemperatureWander
from .truth import Truth, operating_point, truth_of

__all__ = ["Capture", "GyroSimulator"]

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


#: raw channels in the order of the kernel
RAW_NAMES = ("x_pick", "y_pick", "x_drive", "y_drive", "phase_ref")


@dataclass(frozen=True)
class Capture:
    """Rows with the converter samples made meanwhile.

    Parameters
    ----------
    rows : ndarray, shape (n, 12)
        Recording columns.
    raw : dict of str to ndarray, shape (m,)
        ``t`` [s], pick-offs, drives as the converter holds them from each sample on [V], ``phase_ref`` [rad].
    """

    rows: FloatArray
    raw: dict[str, FloatArray]


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
            Something that this device's loops do not do.
        """
        check_command(command)
        gap = self._device.pickoff.gap_amplitude_v
        largest = command.setpoints.amplitude_v * (1.0 + abs(command.excitation.index))
        if gap and largest > 0.7 * gap:
            raise DeviceError(f"Amplitude must stay below 0.7 of the gap, {0.7 * gap:.3g} V, but got {largest:.3g} V. Lower the set point.")
        hand_over(self._plant.loop, self._command, command)
        self._command = command
        self._plant.param[:] = loop_parameters(self._device, command)
        self._segment += 1
        return self._segment

    def move_to_temperature(self, temperature_degc: float, over_s: float = 0.0) -> None:
        """Move the mean temperature of the resonator from now on, as a chamber does; ramp and wander of its environment go on about it.

        Parameters
        ----------
        temperature_degc : float
            Where it ends.
        over_s : float
            Device time that it takes, evenly; 0: at once.

        Raises
        ------
        DeviceError
            A temperature that is not physical, or a negative time.
        """
        if not over_s >= 0.0:
            raise DeviceError(f"Argument over_s must be >= 0, but got {over_s!r}.")
        # the environment checks the temperature; truth is at the new one
        self._device = replace(self._device, environment=replace(self._device.environment, temperature_degc=temperature_degc))
        self._wander.move_to(temperature_degc, self.time_s, over_s)

    def advance(self, duration_s: float, rate_rad_s: ArrayLike = 0.0) -> FloatArray:
        """Simulate and return the rows, shape (n, 12), ``n`` = duration in whole rows.

        Parameters
        ----------
        duration_s : float
            Device time [s].
        rate_rad_s : float or ndarray
            Input rate; an array is spread evenly over the duration, held between its samples [rad/s].
        """
        rates = self._spread(duration_s, rate_rad_s)
        if rates.size == 0:
            return np.zeros((0, 12))
        chunk = max(1, round(self._chunk_s / self._clock.row_s))
        return np.concatenate([self._advance_rows(rates[i : i + chunk]) for i in range(0, rates.size, chunk)])

    def _spread(self, duration_s: float, rate_rad_s: ArrayLike) -> FloatArray:
        """Input rate of every row of a stretch."""
        count = max(0, round(duration_s / self._clock.row_s))
        rates = np.atleast_1d(np.asarray(rate_rad_s, dtype=float))
        return np.asarray(rates[np.minimum((np.arange(count) * rates.size) // max(count, 1), rates.size - 1)])

    def capture_raw(self, duration_s: float, rate_rad_s: ArrayLike = 0.0) -> Capture:
        """Simulate and return the converter samples besides the rows.

        Lags, slow parts and skew of the pick-offs' electronics (effects) act behind the demodulator: the rows have them, the samples not.
        Drives are what was commanded.

        Parameters
        ----------
        duration_s : float
            Device time, in whole rows [s]; a second is some ten megabytes.
        rate_rad_s : float or ndarray
            Input rate, as in :meth:`advance` [rad/s].

        Raises
        ------
        DeviceError
            The slow flow has no converter samples.
        """
        if not isinstance(self._plant, CarrierPlant):
            raise DeviceError("Argument fidelity must be 'carrier' for raw samples, but got 'slow_flow'. Simulate the carrier.")
        rates = self._spread(duration_s, rate_rad_s)
        chunk = max(1, round(self._chunk_s / self._clock.row_s))
        start = self.time_s
        made = [self._advance_raw(rates[i : i + chunk]) for i in range(0, rates.size, chunk)]
        samples = np.concatenate([raw for _, raw in made]) if made else np.zeros((0, len(RAW_NAMES)))
        t = start + np.arange(len(samples)) / self._device.electronics.adc_rate_hz
        raw = {"t": t} | {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(RAW_NAMES)}
        return Capture(np.concatenate([rows for rows, _ in made]) if made else np.zeros((0, 12)), raw)

    def _advance_raw(self, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert isinstance(self._plant, CarrierPlant)
        temperature = self._wander.rows(self.time_s, rates.size, self._clock.row_s)
        channels, raw = self._plant.rows_and_raw(rates, temperature)
        return self._stamped(channels, temperature), raw

    def _advance_rows(self, rates: FloatArray) -> FloatArray:
        temperature = self._wander.rows(self.time_s, rates.size, self._clock.row_s)
        return self._stamped(self._plant.rows(rates, temperature), temperature)

    def _stamped(self, channels: FloatArray, temperature: FloatArray) -> FloatArray:
        """Columns of the contract from what the plant made; counts the rows."""
        count = temperature.size
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
