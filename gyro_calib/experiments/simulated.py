"""A simulated gyro behind the instrument seam, in process."""

from __future__ import annotations

from typing import Any

from ..recording.command import Command
from ..recording.recording import Recording
from ..simulation import GyroSimulator

__all__ = ["SimulatedInstrument"]


class SimulatedInstrument:
    """Implements :class:`.instrument.Instrument` on a :class:`~gyro_calib.simulation.GyroSimulator`.

    Parameters
    ----------
    simulator : GyroSimulator
        The simulated gyro.
    rate_rad_s : float
        Constant input rate, hidden from whoever uses the instrument.
    """

    def __init__(self, simulator: GyroSimulator, rate_rad_s: float = 0.0) -> None:
        self._simulator = simulator
        self._rate = rate_rad_s
        self._fresh = True

    @property
    def device_id(self) -> str:
        """Identity of the unit."""
        return self._simulator.device_id

    @property
    def factory(self) -> dict[str, Any]:
        """What left the factory with the unit."""
        return self._simulator.factory

    def configure(self, command: Command) -> None:
        """Put a command in force."""
        self._simulator.configure(command)
        self._fresh = True

    def record(self, duration_s: float, *, settle_s: float = 0.0, label: str = "") -> Recording:
        """Simulate the settling time (the first time after a command), then record."""
        if self._fresh and settle_s > 0.0:
            self._simulator.advance(settle_s, self._rate)
        self._fresh = False
        rows = self._simulator.advance(duration_s, self._rate)
        extras = {"dac_zero_order_hold_s": self.factory["dac_zero_order_hold_s"], "settle_s": settle_s}
        return Recording(self.device_id, rows, self._simulator.command, self._simulator.sample_rate_hz, label, extras)
