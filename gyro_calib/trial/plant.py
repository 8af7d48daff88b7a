"""Record a drawn unit at carrier level, as a stranger's logger would."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from ..device import Device
from ..experiments import Plan, SimulatedInstrument, run_plan
from ..recording.columns import column_index
from ..recording.recording import Campaign, Recording
from ..simulation import GyroSimulator
from .units import Unit

__all__ = ["record_unit", "with_effects"]

Sizes = Mapping[str, Mapping[str, float]]
#: correlation time of the thermometer's own drift [s]
_SENSOR_DRIFT_S = 100.0


def with_effects(device: Device, effects: Sizes) -> Device:
    """The device with effects on top of its healthy coefficients: of one that it has already the sizes add up."""
    sizes = {name: dict(values) for name, values in device.effects.items()}
    for name, values in effects.items():
        have = sizes.setdefault(name, {})
        for key, value in values.items():
            have[key] = have.get(key, 0.0) + value
    return replace(device, effects=sizes)


def record_unit(
    unit: Unit,
    plan: Plan,
    effects: Sizes,
    rng: np.random.Generator,
    *,
    ramp_k_per_s: float = 0.0,
    on_progress: Callable[[float], None] | None = None,
) -> Campaign:
    """Run a plan on a unit with effects.

    Parameters
    ----------
    unit : Unit
    plan : Plan
    effects : mapping
        What the unit has besides being healthy: name -> parameter -> size.
    rng : numpy.random.Generator
        Source of all noise.
    ramp_k_per_s : float
        Steady drift of the temperature during the campaign.
    on_progress : callable, optional
        Called with the fraction of device time.
    """
    device = with_effects(unit.device, effects)
    device = replace(device, environment=replace(device.environment, ramp_k_per_s=ramp_k_per_s))
    simulator = GyroSimulator(device, rng=rng, fidelity="carrier")
    instrument = SimulatedInstrument(simulator, unit.rate_rad_s, sense_axis=unit.sense_axis)
    campaign = run_plan(instrument, plan, on_progress=None if on_progress is None else lambda p: on_progress(p.fraction))
    sensor = _Sensor(unit, np.random.default_rng(rng.integers(0, 2**63, size=2)))
    return replace(campaign, recordings=tuple(_logged(r, unit, sensor) for r in campaign))


class _Sensor:
    """A thermometer near the resonator: late, noisy, and with a drift of its own."""

    def __init__(self, unit: Unit, rng: np.random.Generator) -> None:
        self._unit, self._rng = unit, rng
        self._drift = unit.sensor_drift_k * float(rng.standard_normal())
        self._last_s: float | None = None

    def read(self, recording: Recording) -> np.ndarray:
        u, true, row_s = self._unit, recording.temperature_degc, 1.0 / recording.sample_rate_hz
        if self._last_s is not None:
            self._forget(float(recording.t[0]) - self._last_s)
        keep = np.exp(-row_s / _SENSOR_DRIFT_S)
        kicks = u.sensor_drift_k * np.sqrt(1.0 - keep**2) * self._rng.standard_normal(true.size)
        drift, _ = lfilter([1.0], [1.0, -keep], kicks, zi=[keep * self._drift])
        self._drift, self._last_s = float(drift[-1]), float(recording.t[-1])
        late = true
        if u.sensor_lag_s > 0.0:
            stay = np.exp(-row_s / u.sensor_lag_s)
            late, _ = lfilter([1.0 - stay], [1.0, -stay], true, zi=[stay * true[0]])
        return np.asarray(late + drift + u.sensor_noise_k * self._rng.standard_normal(true.size))

    def _forget(self, gap_s: float) -> None:
        keep = np.exp(-max(gap_s, 0.0) / _SENSOR_DRIFT_S)
        self._drift = keep * self._drift + self._unit.sensor_drift_k * np.sqrt(1.0 - keep**2) * float(self._rng.standard_normal())


def _logged(recording: Recording, unit: Unit, sensor: _Sensor) -> Recording:
    """With the thermometer's reading, and the table's log by the table's own clock."""
    data = recording.data.copy()
    data[:, column_index("temperature")] = sensor.read(recording)
    extras = dict(recording.extras)
    if "applied_rate" in extras:
        words = dict(extras["applied_rate"])
        words["deg_s"] = [rate * (1.0 + unit.table_clock) for rate in words["deg_s"]]
        extras["applied_rate"] = words
        extras["t_run_start"] = float(extras["t_run_start"]) + unit.table_start_s
    return replace(recording, data=data, extras=extras)
