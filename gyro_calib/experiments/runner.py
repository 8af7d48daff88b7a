"""Run a plan on an instrument: progress, abort conditions, cancellation, and the gyro back in its mission whatever happens."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ExperimentAborted, GyroCalibError
from ..recording.command import Command
from ..recording.rate import WAVE_MODES, raw_rate, wave_azimuth
from ..recording.recording import Campaign, Recording
from .instrument import Instrument
from .plan import Plan, Step

__all__ = ["Progress", "run_plan"]

FloatArray = NDArray[np.float64]

#: base motion is looked for in means over this time [s]
_MOTION_WINDOW_S = 0.5
#: a wave that turned by so much of a period of 4 theta shows what goes with its azimuth; columns of that fit
_LEAST_TURN, _COLUMNS = 0.9, 5
#: share of what a drive turns in a nominal unit by which a real one may differ (gains, couplings)
_NOMINAL_SHARE = 0.08


@dataclass(frozen=True)
class Progress:
    """Where a run stands.

    Parameters
    ----------
    fraction : float
        Of the device time, 0 to 1.
    eta_s : float
        Wall time left [s]; NaN until known.
    step_label : str
        Of the step under way.
    step_index, steps : int
        Its number from 0, and how many there are.
    """

    fraction: float
    eta_s: float
    step_label: str
    step_index: int
    steps: int


def run_plan(
    instrument: Instrument,
    plan: Plan,
    *,
    on_progress: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Campaign:
    """Carry out every step and return the campaign.

    Parameters
    ----------
    instrument : Instrument
        The gyro.
    plan : Plan
        What to do.
    on_progress : callable, optional
        Called before each step and at the end.
    cancelled : callable, optional
        Asked before each step; True ends the run.

    Raises
    ------
    ExperimentAborted
        Cancelled, temperature or base moved beyond the plan's limits, or the instrument gave up.
    DataError
        A recording is not usable.
    """
    _check_abilities(instrument, plan)
    started = time.monotonic()
    watch = _Watch(plan, dict(instrument.factory))
    recordings: list[Recording] = []
    done_s = 0.0
    try:
        for index, step in enumerate(plan.steps):
            if cancelled is not None and cancelled():
                raise ExperimentAborted(f"Run was cancelled before step {index + 1} of {len(plan.steps)} ({step.label}).")
            if on_progress is not None:
                fraction = done_s / plan.duration_s
                eta = (time.monotonic() - started) * (1.0 - fraction) / fraction if fraction > 0 else float("nan")
                on_progress(Progress(fraction, eta, step.label, index, len(plan.steps)))
            instrument.configure(_resolved(step, recordings))
            recording = _record(instrument, step)
            watch.check(step, recording)
            recordings.append(replace(recording, extras={**recording.extras, **plan.words}))
            done_s += step.duration_s + step.settle_s
    except BaseException:
        _return_to_mission(instrument, plan)
        raise
    instrument.configure(plan.final)
    if on_progress is not None:
        on_progress(Progress(1.0, 0.0, "", len(plan.steps), len(plan.steps)))
    kept = tuple(recording for recording, step in zip(recordings, plan.steps, strict=True) if step.kept)
    return Campaign(instrument.device_id, kept, dict(instrument.factory))


def _check_abilities(instrument: Instrument, plan: Plan) -> None:
    """A plan that this instrument cannot carry out is refused before an hour of it."""
    needs = frozenset().union(*(step.needs for step in plan.steps))
    missing = sorted(needs - frozenset(getattr(instrument, "abilities", ())))
    if missing:
        words = {"applied_rate": "turn on a rate table", "raw": "keep converter samples", "temperature": "stand in a chamber"}
        raise ExperimentAborted(
            f"Plan {plan.name!r} must run on an instrument that can {' and '.join(words[m] for m in missing)}, but "
            f"{instrument.device_id!r} cannot. Record it with the table's or the converter's own logger and give the file."
        )


def _record(instrument: Instrument, step: Step) -> Recording:
    more: dict[str, Any] = {}
    if step.applied_rate:
        more["applied_rate"] = step.applied_rate
    if step.raw_s > 0.0:
        more["raw_s"] = step.raw_s
    if step.temperature_degc is not None:
        more["temperature_degc"] = step.temperature_degc
        if step.temperature_ramp_s > 0.0:
            more["temperature_ramp_s"] = step.temperature_ramp_s
    return instrument.record(step.duration_s, settle_s=step.settle_s, label=step.label, **more)


def _resolved(step: Step, recordings: list[Recording]) -> Command:
    """The step's command, its detuning referred to the latest closed-loop reference frequency."""
    if step.detuning_hz is None:
        return step.command
    located = [r for r in recordings if r.command.oscillator_axis]
    if not located:
        raise ExperimentAborted(f"Step {step.label} must follow a closed-loop record that locates the resonance, but there was none.")
    frequency = float(np.mean(located[-1].column("ref_freq"))) + step.detuning_hz
    return replace(step.command, excitation=replace(step.command.excitation, frequency_hz=frequency))


def _return_to_mission(instrument: Instrument, plan: Plan) -> None:
    try:
        instrument.configure(plan.final)
    except GyroCalibError:
        # the gyro is out of reach: the first error tells the user why, this one would hide it
        return


class _Watch:
    """Abort conditions, checked on every recording.

    Rates are held against earlier ones of the same amplitude and temperature only: the bias depends on both, more so in a gyro with a
    nonlinearity, and that is not the base.
    """

    def __init__(self, plan: Plan, factory: dict[str, object]) -> None:
        self._limits = plan.limits
        self._factory = factory
        self._temperature: float | None = None
        self._rates: dict[tuple[str, float], float] = {}
        #: rate of the wave, by amplitude, in the recording that the drives disturbed least, and how much they may have [rad/s]
        self._waves: dict[float, tuple[float, float]] = {}

    def check(self, step: Step, recording: Recording) -> None:
        if step.temperature_degc is not None:
            self._rates.clear()
            self._waves.clear()
        if step.temperature_ramp_s > 0.0:
            self._temperature = float(recording.temperature_degc[-1])
            return
        self._check_temperature(step, recording)
        if "nominal_scale_factor_v_per_rad_s" in self._factory and not step.applied_rate:
            self._check_base(step, recording)

    def _check_temperature(self, step: Step, recording: Recording) -> None:
        temperature = recording.temperature_degc
        if self._temperature is None or step.temperature_degc is not None:  # moved on purpose: from there on
            self._temperature = float(temperature[0])
        excursion = float(np.max(np.abs(temperature - self._temperature)))
        if excursion > self._limits.temperature_k:
            raise ExperimentAborted(
                f"Temperature must stay within {self._limits.temperature_k:g} K of its start ({self._temperature:.2f} degC), but moved "
                f"{excursion:.2f} K in step {step.label}. Let the gyro settle, or raise temperature_limit_k."
            )

    def _check_base(self, step: Step, recording: Recording) -> None:
        mode = step.command.mode
        if mode not in WAVE_MODES and step.command.oscillator_axis is None:
            return
        means = _means(raw_rate(recording.data, step.command, self._factory), recording.sample_rate_hz)
        if means.size < 2 or np.isnan(means).any():
            return
        middle = float(np.median(means))
        worst = self._wave_spread(recording, means) if mode in WAVE_MODES else float(np.max(np.abs(means - middle)))
        if step.command.excitation.kind != "none":
            # the modulation itself moves the rate channel: only a motion that the modulation cannot make is held against the base
            worst -= abs(middle) * 2.0 * step.command.excitation.index
        else:
            worst = max(worst, self._moved_since(step, recording, middle))
        if worst > self._limits.base_rate_rad_s:
            limit, moved = np.degrees(self._limits.base_rate_rad_s), np.degrees(worst)
            raise ExperimentAborted(
                f"Base must stay within {limit:.3g} deg/s of rest, but moved {moved:.3g} deg/s in step {step.label}. "
                "Hold the gyro still and run again, or raise base_rate_limit_rad_s."
            )

    def _wave_spread(self, recording: Recording, means: FloatArray) -> float:
        """Largest motion inside a recording of a free wave [rad/s].

        Unbalanced forcers turn the wave with its azimuth: over a period of 4 theta what follows the azimuth is told from a motion of the
        base, over less the forcers are doubted.
        """
        angle = 4.0 * _means(wave_azimuth(recording.data), recording.sample_rate_hz)
        if np.ptp(angle) < 2.0 * np.pi * _LEAST_TURN or means.size < 2 * _COLUMNS:
            return float(np.max(np.abs(means - np.median(means)))) - self._doubt(recording)
        design = np.column_stack([np.ones_like(angle), *(wave(k * angle) for k in (1, 2) for wave in (np.cos, np.sin))])
        return float(np.max(np.abs(means - design @ np.linalg.lstsq(design, means, rcond=None)[0])))

    def _moved_since(self, step: Step, recording: Recording, middle: float) -> float:
        """Change of the rate since the first recording of its kind, beyond what the drives may have done to it [rad/s]."""
        amplitude = step.command.setpoints.amplitude_v
        if step.command.mode not in WAVE_MODES:
            return abs(middle - self._rates.setdefault((step.command.mode, amplitude), middle))
        doubt = self._doubt(recording)
        first, its_doubt = self._waves.get(amplitude, (0.0, np.inf))
        if doubt < its_doubt:
            self._waves[amplitude] = middle, doubt
        return abs(middle - first) - doubt - its_doubt if np.isfinite(its_doubt) else 0.0

    def _doubt(self, recording: Recording) -> float:
        """What the drives of a recording may turn otherwise than in a nominal unit [rad/s]: a share of the input rate they stand for."""
        nominal = self._factory["nominal_scale_factor_v_per_rad_s"]
        if not isinstance(nominal, Mapping) or "x" not in nominal:
            return 0.0
        volts = float(np.sqrt(np.mean(np.sum(recording.data[:, 6:10] ** 2, axis=1))))
        # a volt turns a smaller wave further
        share = recording.command.setpoints.amplitude_v / float(str(self._factory.get("nominal_amplitude_v", 1.0)))
        return _NOMINAL_SHARE * volts / (abs(float(nominal["x"])) * share)


def _means(values: FloatArray, rate_hz: float) -> FloatArray:
    """Means over the time in which a motion of the base is looked for."""
    width = max(1, round(_MOTION_WINDOW_S * rate_hz))
    return np.asarray(values[: values.size // width * width].reshape(-1, width).mean(axis=1))
