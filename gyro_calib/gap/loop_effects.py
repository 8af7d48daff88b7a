"""Effects of the loops, which the slow flow does not show: what they hold against their set points, and how late their drives turn.

The slow flow takes drives and pick-offs as they were, whatever the loops had in mind. So these stand beside the effects of the fit: a loop
with an integrator holds its set point as its own reading has it (sixty-eight devices of three plants: to 6e-6), and a wave that turns tells
the latency of its drives (:mod:`gyro_calib.estimation.latency`), of which the control alone has up to six periods.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..estimation.factory_values import factory_value
from ..estimation.held import settled_mean
from ..estimation.latency import loop_latency
from ..estimation.wave import wave_coordinates
from ..quantity import Quantity
from ..recording.recording import Recording
from .diagnosis import FoundEffect, Standing
from .spectra import plain_records
from .spectral_effects import SEEN, SIGMA, found_beside

__all__ = ["LOOP_EFFECTS", "LoopEffects", "loop_effects"]

FloatArray = NDArray[np.float64]
LOOP_EFFECTS = ("loop_error", "angle_latency")

#: what a loop may leave of its error after it has settled, of the amplitude (sd)
_SETTLED = 1e-6
#: quadrature and azimuth that zeros of demodulators and set points leave: three healthy hemispheres of a plant held up to 5e-5, and
#: effects.md has 1e-4 to 1e-2 as an effect
_ZEROS = {"a": 0.0, "q": 9e-5, "psi": 9e-5}
#: an amplitude that misses its set point by another scale of columns and loop: at most, to what share of it alike in all records, and how
#: far apart temperatures are that tell a loop by its damping [K], which goes by 1e-3/K and more
_SCALE, _ALIKE, _APART_K = 1e-2, 5e-3, 4.0
#: share of the converter's range from which on a drive is at its end, and no loop can hold what it holds
_FULL = 0.98
#: how well the factory knows its latency; what control has where nothing is said, in its periods: from half (a drive at once) to twelve, of
#: overlapping windows, periods of computing, filters and a pole of the amplifier (six plants came to 0.9 to 3.3, a seventh to 2.2 to 5.6,
#: an eighth to 2.8 to 10.0)
_STATED, _MEAN_PERIODS, _SD_PERIODS, _MOST_PERIODS = 0.1, 5.0, 3.0, 12.0


@dataclass(frozen=True)
class LoopEffects:
    """Effects that were found, a line for each that there is, and what is no effect and should be known."""

    effects: tuple[FoundEffect, ...]
    standings: tuple[Standing, ...]
    warnings: tuple[str, ...] = ()


def loop_effects(recordings: Sequence[Recording], factory: Mapping[str, Any], without: Collection[str] = ()) -> LoopEffects:
    """What the loops hold, and when.

    Parameters
    ----------
    recordings : sequence of Recording
    factory : mapping
        ``dac_full_scale_V``, ``loop_latency_s`` and ``control_rate_hz``, where it says them.
    without : collection of str
        Effects that the registry shall not hold.
    """
    held = _held(recordings, factory_value(factory, "dac_full_scale_V") or np.inf)
    scale = _scale_of_columns(recordings, held)
    if scale is not None:
        held = {**held, "a": held["a"] - scale}
    found = [_loop_error(held), _angle_latency(recordings, factory)]
    effects, lines = [], []
    for name, (effect, seen_from) in zip(LOOP_EFFECTS, found, strict=True):
        if name in without:
            continue
        status = "present" if effect is not None else "excluded" if seen_from is not None else "not testable"
        lines.append(Standing(name, EFFECTS[name].title, EFFECTS[name].location, status, seen_from, 0.0, 0.0, 0.0))
        effects += [] if effect is None else [effect]
    return LoopEffects(tuple(effects), tuple(lines), () if scale is None else (_said(scale),))


def _loop_error(held: Mapping[str, FloatArray]) -> tuple[FoundEffect | None, Quantity | None]:
    """The effect, if a loop misses its set point, and the size that would be seen."""
    sizes = {name: _middle(values) for name, values in held.items() if values.size}
    if not sizes:
        return None, None
    units = {p.name: p.unit for p in EFFECTS["loop_error"].parameters}
    missed = {name: Quantity(value, sd, units[name]) for name, (value, sd) in sizes.items()}
    if not any(_counts(name, q.value, q.sd) for name, q in missed.items()):
        worst_sd = max(q.sd for q in missed.values())
        return None, Quantity(max(SEEN * worst_sd, *(_ZEROS[name] for name in missed)), worst_sd, "1")
    return found_beside("loop_error", missed, SIGMA**2, harmless=False), None


def _scale_of_columns(recordings: Sequence[Recording], held: Mapping[str, FloatArray]) -> float | None:
    """By how much the columns read an amplitude as larger than the loop that holds it, if they do, and the loop errs in nothing.

    A filter of the converter before the demodulators: a share of 1.05e-3 that is alike at all amplitudes, on both axes, warm and cold. What
    a loop without an integrator leaves is too little, never too much, and goes with the drive that it needs, so with the damping.
    """
    others = [_counts(name, *_middle(held[name])) for name in ("q", "psi") if held[name].size]
    if not held["a"].size or any(others):
        return None
    still = [r for r in plain_records(recordings) if not r.command.setpoints.virtual_precession_v and r.command.excitation.kind == "none"]
    missed = _held(still, np.inf)["a"]
    value, sd = _middle(held["a"])
    if not missed.size or not SIGMA * sd < abs(value) < _SCALE or np.ptp(missed) > _ALIKE * abs(value):
        return None
    warmth = [float(np.median(r.temperature_degc)) for r in still]
    return value if value > 0.0 or np.ptp(warmth) > _APART_K else None


def _said(scale: float) -> str:
    return (
        f"Amplitudes are {1.0 + scale:.6f} of their set points in all recordings alike: the columns' scale is not that of "
        "the loop's own reading. Drives and pick-offs are taken as recorded; no rate depends on it."
    )


def _held(recordings: Sequence[Recording], full_scale_v: float) -> dict[str, FloatArray]:
    """What is left of the loops' set points by recording: amplitude less one, quadrature, azimuth of force to rebalance."""
    found: dict[str, list[float]] = {"a": [], "q": [], "psi": []}
    for r in plain_records(recordings):
        amplitude_v = r.command.setpoints.amplitude_v
        if amplitude_v <= 0.0 or float(np.abs(r.drive).max()) > _FULL * full_scale_v:
            continue
        axis = r.command.oscillator_axis
        if axis is None:
            wave = wave_coordinates(r)
            amplitude, quadrature = wave.amplitude_v, wave.quadrature_v / wave.amplitude_v
        else:
            k = "xy".index(axis)
            side = 1.0 if axis == "x" else -1.0
            amplitude, closed = np.abs(r.pick[:, k]), side * r.pick[:, 1 - k] / r.pick[:, k]
            quadrature = -closed.imag
            if r.command.setpoints.rebalance:
                found["psi"].append(settled_mean(closed.real))
        if axis is None or r.command.setpoints.rebalance:
            found["q"].append(settled_mean(quadrature))
        if r.command.excitation.kind == "none":
            found["a"].append(settled_mean(amplitude / amplitude_v - 1.0))
    return {name: np.array(values) for name, values in found.items()}


def _counts(name: str, value: float, sd: float) -> bool:
    """Whether a loop misses its set point by more than healthy ones do."""
    return abs(value) >= max(SIGMA * sd, _ZEROS[name])


def _middle(values: FloatArray) -> tuple[float, float]:
    """Median of the recordings, and its sd."""
    middle = float(np.median(values))
    scatter = 1.4826 * float(np.median(np.abs(values - middle)))
    return middle, float(np.hypot(_SETTLED, 1.253 * scatter / np.sqrt(values.size)))


def _angle_latency(recordings: Sequence[Recording], factory: Mapping[str, Any]) -> tuple[FoundEffect | None, Quantity | None]:
    """The effect, if the drives' direction is later than control makes it, and the latency that would be seen."""
    latency, control = loop_latency(recordings), _of_control(recordings, factory)
    if latency is None or control is None:
        return None, None
    expected, most_s = control
    beyond = (latency.value - most_s) / latency.sd
    if beyond < SIGMA:
        return None, Quantity(most_s - expected.value + SEEN * latency.sd, latency.sd, "s")
    excess = Quantity(latency.value - expected.value, float(np.hypot(latency.sd, expected.sd)), "s")
    return found_beside("angle_latency", {"tau": excess}, SIGMA**2, harmless=False), None


def _of_control(recordings: Sequence[Recording], factory: Mapping[str, Any]) -> tuple[Quantity, float] | None:
    """Latency of the control itself, and the most that it may have [s]: as the factory says, or by its period."""
    stated = factory_value(factory, "loop_latency_s")
    if stated > 0.0:
        sd = _STATED * stated
        return Quantity(stated, sd, "s"), stated + 2.0 * sd
    rates = [rate for of in (*(r.extras for r in recordings), factory) if (rate := factory_value(of, "control_rate_hz")) > 0.0]
    if not rates:
        return None
    period_s = 1.0 / min(rates)
    return Quantity(_MEAN_PERIODS * period_s, _SD_PERIODS * period_s, "s"), _MOST_PERIODS * period_s
