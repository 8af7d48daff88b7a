"""A simulated gyro behind the instrument seam, in process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import applied_rate as rate_of_table
from ..recording.applied_rate import table_axis
from ..recording.command import Command
from ..recording.recording import Recording
from ..simulation import GyroSimulator

__all__ = ["SimulatedInstrument"]

FloatArray = NDArray[np.float64]


class SimulatedInstrument:
    """Implements :class:`.instrument.Instrument` on a :class:`~gyro_calib.simulation.GyroSimulator`, with a rate table and a chamber.

    Parameters
    ----------
    simulator : GyroSimulator
        The simulated gyro.
    rate_rad_s : float
        Constant input rate, hidden from whoever uses the instrument.
    sense_axis : tuple of 3 float
        Sensitive axis in the frame of the case, normalised here: the mounting's misalignment, hidden likewise.
    """

    abilities = frozenset({"applied_rate", "raw", "temperature"})

    def __init__(
        self, simulator: GyroSimulator, rate_rad_s: float = 0.0, *, sense_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    ) -> None:
        self._simulator = simulator
        self._rate = rate_rad_s
        self._sense_axis = np.asarray(sense_axis, dtype=float) / float(np.linalg.norm(sense_axis))
        self._fresh = True

    @property
    def device_id(self) -> str:
        """Identity of the unit."""
        return self._simulator.device_id

    @property
    def factory(self) -> dict[str, Any]:
        """What left the factory with the unit."""
        return self._simulator.factory

    @property
    def command(self) -> Command:
        """What is in force."""
        return self._simulator.command

    def configure(self, command: Command) -> None:
        """Put a command in force."""
        self._simulator.configure(command)
        self._fresh = True

    def record(
        self,
        duration_s: float,
        *,
        settle_s: float = 0.0,
        label: str = "",
        applied_rate: Mapping[str, Any] | None = None,
        raw_s: float = 0.0,
        temperature_degc: float | None = None,
        temperature_ramp_s: float = 0.0,
    ) -> Recording:
        """Simulate the settling time (the first time after a command), then record.

        Parameters
        ----------
        duration_s, settle_s, label
            As in the protocol.
        applied_rate : mapping, optional
            How a table turns the gyro from the start of the record on (:mod:`gyro_calib.recording.applied_rate`).
        raw_s : float
            Converter samples are kept of this long at the end [s]; carrier fidelity only.
        temperature_degc : float, optional
            Where a chamber takes the gyro in the first half of the settling time, and keeps it from then on.
        temperature_ramp_s : float
            The chamber does so in the first so many seconds of the record instead [s].
        """
        simulator = self._simulator
        if temperature_degc is not None and not temperature_ramp_s:
            simulator.move_to_temperature(temperature_degc, 0.5 * settle_s if self._fresh else 0.0)
        if self._fresh and settle_s > 0.0:
            simulator.advance(settle_s, self._rate)
        self._fresh = False
        if temperature_degc is not None and temperature_ramp_s:
            simulator.move_to_temperature(temperature_degc, temperature_ramp_s)
        extras: dict[str, Any] = {"dac_zero_order_hold_s": self.factory["dac_zero_order_hold_s"], "settle_s": settle_s}
        if applied_rate is not None:
            extras["applied_rate"] = dict(applied_rate)
            extras["t_run_start"] = simulator.time_s - settle_s
        rates = self._rate + self._turned(duration_s, label, extras)
        whole = rates.size - round(raw_s * simulator.sample_rate_hz)
        rows, raw = [simulator.advance(whole / simulator.sample_rate_hz, rates[:whole])] if whole else [], None
        if whole < rates.size:
            capture = simulator.capture_raw((rates.size - whole) / simulator.sample_rate_hz, rates[whole:])
            rows.append(capture.rows)
            raw = capture.raw
        return Recording(self.device_id, np.concatenate(rows), simulator.command, simulator.sample_rate_hz, label, extras, raw)

    def _turned(self, duration_s: float, label: str, extras: dict[str, Any]) -> FloatArray:
        """The table's rate about the sense axis while each row is made [rad/s], shape (rows,)."""
        simulator = self._simulator
        count = round(duration_s * simulator.sample_rate_hz)
        row_s = 1.0 / simulator.sample_rate_hz
        blank = np.zeros((count, 12))
        blank[:, 0] = simulator.time_s + (np.arange(count) + 0.5) * row_s
        made = Recording(self.device_id, blank, simulator.command, simulator.sample_rate_hz, label, extras)
        return rate_of_table(made)[0] * float(table_axis(made) @ self._sense_axis)
