"""A thermometer that errs: what follows the temperature errs with it, by a number of its own in every record, and within records.

A sensor knows nothing of a resonator's own millikelvins, and they are healthy. But a gain of 1e-4/K that follows them is 1e-7 of an
amplitude, more than a quiet hemisphere's noise, and as the loop's phase follows the resonance too it looks like a pump at twice the
reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from .column import Column
from .evidence import CampaignEvidence, RecordingEvidence
from .linear_device import span_k
from .nuisance import BOTH_PICKOFFS, NOTICED_K, following_columns
from .parts import Linear, motion, unexplained
from .signals import SMOOTH_S, with_temperature

__all__ = [
    "OWN",
    "THERMOMETER",
    "own_columns",
    "own_detuning_rad_s",
    "said_sensor_late",
    "sensor_late_s",
    "thermometer_columns",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: how the names of these columns begin
THERMOMETER = "thermometer_"
#: what follows the resonator's own millikelvins within a record
OWN = "own_millikelvins"
#: modes that hold a wave at one amplitude
_HELD = ("whole_angle", "ftr_x", "ftr_y")
#: a relative change of the resonance with temperature that few have less of [1/K]
_LEAST_PER_K = 5e-6
#: a sensor that is later than this is no good one [s]
_LATE_S = 0.4


def thermometer_columns(evidence: CampaignEvidence, linear: Linear, values: Mapping[str, float], error_k: float) -> list[Column]:
    """What a kelvin of a sensor's noise, of its drift or of its distance from the resonator makes, record by record.

    The resonance alone tells where it was (`wander_columns`); damping, gains and phases were taken at the temperature that was read.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    values : mapping
        What follows the temperature as it was found, by name.
    error_k : float
        How far a sensor may be from the resonator [K].
    """
    if span_k(evidence) < NOTICED_K:
        return []
    warmer = replace(evidence, recordings=tuple(replace(r, signals=with_temperature(r.signals, 1.0)) for r in evidence))
    found = [c for c in following_columns(warmer, linear) if values.get(c.name)]
    columns = []
    for k, r in enumerate(evidence):
        signal = _alone(k, [values[c.name] * c.signal[k] for c in found], [o.signal.lhs.size for o in evidence])
        quiet = _alone(k, [values[c.name] * c.quiet[k] for c in found], [o.quiet.lhs.size for o in evidence])
        if r.is_wave and np.any(signal[k]):
            columns.append(Column(f"{THERMOMETER}{r.index}", signal, quiet, error_k))
    return columns


def own_columns(evidence: CampaignEvidence, linear: Linear, values: Mapping[str, float]) -> list[Column]:
    """What follows the temperature follows a resonator's own millikelvins within a record, which its resonance alone shows.

    Of a size that is known once the temperature was varied: the column's own is one. Without, it is a pick-off's gain as a healthy device
    may have it, and a resonance that follows the temperature as few do less.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    values : mapping
        What follows the temperature as it was found, by name.
    """
    sizes, slope = values, linear.frequency_slope_rad_s_k
    if span_k(evidence) < NOTICED_K or not slope:
        sizes, slope = {BOTH_PICKOFFS: evidence.healthy.gain_per_k}, _LEAST_PER_K * evidence.omega0_rad_s
    own = [replace(r, signals=with_temperature(r.signals, own_detuning_rad_s(r, linear, values) / slope)) for r in evidence]
    found = [c for c in following_columns(replace(evidence, recordings=tuple(own)), linear) if sizes.get(c.name)]
    if not found:
        return []
    signal, quiet = (
        tuple(sum(sizes[c.name] * side for c, side in zip(found, sides, strict=True)) for sides in zip(*by_column, strict=True))
        for by_column in ([c.signal for c in found], [c.quiet for c in found])
    )
    return [Column(OWN, signal, quiet, 1.0)] if any(np.any(v) for v in signal) else []


def own_detuning_rad_s(r: RecordingEvidence, linear: Linear, values: Mapping[str, float]) -> FloatArray:
    """How far the resonance was from where the thermometer puts it, beyond the mean of the record [rad/s], shape (n,).

    Of a wave that is held at one amplitude; zero in other records. The distance from where the linear device has it is what turns the
    phase of the wave: ``Im(p^H (L[p] - A p - G u)) / |p|^2``, p the motion. The slope that the fit gave comes to that.
    """
    s = r.signals
    if r.recording.command.mode not in _HELD:
        return np.zeros(s.time_s.shape)
    p, rest = motion(s, linear), unexplained(s, linear)
    away = np.einsum("na,na->n", p.conj(), rest).imag / np.einsum("na,na->n", p.conj(), p).real
    away += values.get(f"slide_{r.index}", 0.0) * np.linspace(-1.0, 1.0, len(away))
    smooth = uniform_filter1d(away, max(round(SMOOTH_S / s.row_s), 1), mode="nearest")
    return np.asarray(smooth - smooth.mean())


def sensor_late_s(values: Mapping[str, float]) -> float:
    """How late the sensor is [s], if it is later than a good one: a resonator that is later than its sensor is an effect, this is none.

    What follows the temperature is then ahead of what it says, by the rate of its change, as no healthy device is taken to be.
    """
    late_s = -values.get("thermal_lag.tau", 0.0)
    return late_s if late_s > _LATE_S else 0.0


def said_sensor_late(late_s: float) -> list[str]:
    """A line on a sensor that was late."""
    if not late_s:
        return []
    return [
        f"The thermometer is {late_s:.2g} s later than the resonator's frequency, and what has no name and goes with the rate of change of "
        "the temperature is not told from that. Measure the resonator's own temperature, or ramp it more slowly."
    ]


def _alone(k: int, parts: list[ComplexArray], sizes: list[int]) -> tuple[ComplexArray, ...]:
    """The sum of parts in recording k, nothing in the others."""
    return tuple(sum(parts, np.zeros(n, complex)) if j == k else np.zeros(n, complex) for j, n in enumerate(sizes))
