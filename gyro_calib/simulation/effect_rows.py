"""Slow effects row by row: what temperature, time and rotation change in dynamics, drive and pick-off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ..device import Device, J
from . import effect_layout as at

__all__ = ["SLOW_EFFECTS", "SlowEffects", "SlowTerms", "add_to_carrier", "flow_with", "kernel_rows"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: effects of this module besides the feedthrough that moves
SLOW_EFFECTS = frozenset(
    (
        "thermal_damping", "thermal_damping_curvature", "thermal_damping_anisotropy",
        "thermal_frequency_curvature", "thermal_split", "thermal_split_curvature", "thermal_lag",
        "thermal_frequency_lag", "thermal_damping_lag", "thermal_damping_anisotropy_lag", "thermal_split_lag",
        "thermal_drive_gain_lag", "thermal_pickoff_gain_lag", "thermal_bias", "thermal_bias_lag", "bias_drift",
        "thermal_drive_gain", "thermal_drive_phase", "thermal_pickoff_gain", "thermal_pickoff_phase",
        "thermal_drive_gain_curvature", "thermal_pickoff_gain_curvature", "thermal_drive_coupling", "thermal_pickoff_coupling",
        "drive_coupling_drift", "pickoff_coupling_drift",
        "frequency_ageing", "clock_drift", "damping_drift", "split_drift", "charge_accumulation", "drive_gain_drift", "drive_phase_drift",
        "pickoff_gain_drift", "pickoff_phase_drift", "centrifugal_stiffness", "centrifugal_stiffness_axes", "rate_dependent_damping",
        "angular_gain_error", "rate_nonlinearity", "rate_asymmetry", "base_sway",
    )
)  # fmt: skip


@dataclass(frozen=True)
class SlowTerms:
    """What the effects change in a stretch of rows.

    Parameters
    ----------
    stiffness, damping : ndarray, shape (rows, 2, 2)
        Added to ``p' = (i stiffness - damping) p``: frequency and its split [rad/s], decay rate, its anisotropy and rotation [1/s].
    drive, pick : ndarray, shape (rows, 2, 2), complex
        What multiplies the drives and the pick-offs, a row's axis by a column's.
    feed : ndarray, shape (rows, 2, 2), complex
        Feedthrough that is added, to a row's axis of a column's drive.
    """

    stiffness: FloatArray
    damping: FloatArray
    drive: ComplexArray
    pick: ComplexArray
    feed: ComplexArray


class SlowEffects:
    """Slow effects of a device; keeps the temperatures that lag from call to call.

    Parameters
    ----------
    device : Device
        Whose effects.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._effects = device.effects
        self._row_s = 1.0 / device.electronics.sample_rate_hz
        self._rows_made = 0
        self._lagged_k: dict[str, float] = {}

    def terms(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> SlowTerms:
        """Terms of the next rows; each is taken at its middle."""
        d, count = self._device, rate_rad_s.size
        t = np.asarray((self._rows_made + np.arange(count) + 0.5) * self._row_s, dtype=np.float64)
        self._rows_made += count
        rise = np.asarray(temperature_degc - d.resonator.reference_temperature_degc, dtype=np.float64)
        return SlowTerms(
            self._stiffness(t, rise, rate_rad_s),
            self._damping(t, rise, rate_rad_s),
            self._factor("drive", t, rise),
            self._factor("pickoff", t, rise),
            # none where drives and readings do not meet, as Device.feedthrough_matrix
            self._feed(t, rise) * float(not (d.multiplexing.enabled or d.drive.at_twice_frequency)),
        )

    def _size(self, effect: str, parameter: str) -> float:
        return self._effects[effect][parameter] if effect in self._effects else 0.0

    def _pair(self, effect: str, first: str, second: str, by: FloatArray) -> FloatArray:
        return np.stack([self._size(effect, first) * by, self._size(effect, second) * by], axis=1)

    def _stiffness(self, t: FloatArray, rise: FloatArray, rate: FloatArray) -> FloatArray:
        same = self._size("thermal_frequency_curvature", "k") * rise**2
        same = same + self._size("frequency_ageing", "k") * t + self._size("centrifugal_stiffness", "k") * rate**2
        same = same + self._size("thermal_frequency_lag", "k") * self._behind("thermal_frequency_lag", rise)
        split = self._pair("thermal_split", "k_c", "k_s", rise) + self._pair("split_drift", "k_c", "k_s", t)
        split = split + self._pair("thermal_split_lag", "k_c", "k_s", self._behind("thermal_split_lag", rise))
        split = split + self._pair("thermal_split_curvature", "k_c", "k_s", rise**2)
        if "charge_accumulation" in self._effects:
            charged = -np.expm1(-t / self._size("charge_accumulation", "tau"))
            same = same + self._size("charge_accumulation", "k_0") * charged
            split = split + self._pair("charge_accumulation", "k_c", "k_s", charged)
        by_axis = self._pair("centrifugal_stiffness_axes", "k_x", "k_y", rate**2)
        across = self._size("centrifugal_stiffness_axes", "k_s") * rate**2
        same, split = same + by_axis.mean(axis=1), split + np.stack([by_axis @ [0.5, -0.5], across], axis=1)
        r = self._device.resonator
        same = same - r.omega0_rad_s * self._size("clock_drift", "e") * t
        same = same - r.frequency_tempco_per_k * r.omega0_rad_s * self._behind("thermal_lag", rise)
        return _symmetric(same, split)

    def _damping(self, t: FloatArray, rise: FloatArray, rate: FloatArray) -> FloatArray:
        same = self._size("thermal_damping", "c") * rise + self._size("damping_drift", "c") * t
        same = same + self._size("rate_dependent_damping", "c") * rate
        same = same + self._size("thermal_damping_lag", "c") * self._behind("thermal_damping_lag", rise)
        late = "thermal_damping_anisotropy_lag"
        unequal = self._pair("thermal_damping_anisotropy", "c_c", "c_s", rise) + self._pair(late, "c_c", "c_s", self._behind(late, rise))
        excess = self._size("angular_gain_error", "e") + self._size("rate_nonlinearity", "e") * np.abs(rate)
        excess = excess + self._size("rate_asymmetry", "e") * rate
        bias = self._size("thermal_bias", "b") * rise + self._size("bias_drift", "b") * t
        bias = bias + self._size("thermal_bias_lag", "b") * self._behind("thermal_bias_lag", rise)
        swayed = 2.0 * math.pi * self._size("base_sway", "frequency_hz") * t + self._size("base_sway", "phase_rad")
        bias = bias + self._size("base_sway", "r") * np.cos(swayed)
        turn = self._device.resonator.angular_gain * (excess * rate + bias)
        damping = self._device.resonator.damping_matrix()
        bent = self._size("thermal_damping_curvature", "c") * np.multiply.outer(rise**2, 2.0 * damping / np.trace(damping))
        return np.asarray(_symmetric(same, unequal) + bent + turn[:, None, None] * J)

    def _factor(self, chain: str, t: FloatArray, rise: FloatArray) -> ComplexArray:
        gain = 1.0 + self._pair(f"thermal_{chain}_gain", "g_x", "g_y", rise) + self._pair(f"{chain}_gain_drift", "g_x", "g_y", t)
        late = f"thermal_{chain}_gain_lag"
        gain = gain + self._pair(f"thermal_{chain}_gain_curvature", "g_x", "g_y", rise**2)
        gain = gain + self._pair(late, "g_x", "g_y", self._behind(late, rise))
        phase = self._pair(f"thermal_{chain}_phase", "g_x", "g_y", rise) + self._pair(f"{chain}_phase_drift", "g_x", "g_y", t)
        coupled = self._pair(f"thermal_{chain}_coupling", "c_x", "c_y", rise) + self._pair(f"{chain}_coupling_drift", "c_x", "c_y", t)
        own = gain * np.exp(1j * phase)
        return np.asarray(own[:, :, None] * np.eye(2) + coupled[:, :, None] * np.eye(2)[::-1], dtype=np.complex128)

    def _feed(self, t: FloatArray, rise: FloatArray) -> ComplexArray:
        own = self._pair("thermal_feedthrough", "e_x", "e_y", rise) + self._drifting_feed("feedthrough_drift", t)
        across = self._drifting_feed("cross_feedthrough_drift", t)
        return own[:, :, None] * np.eye(2) + across[:, :, None] * np.eye(2)[::-1]

    def _drifting_feed(self, effect: str, t: FloatArray) -> ComplexArray:
        return self._pair(effect, "e_xc", "e_yc", t) + 1j * self._pair(effect, "e_xs", "e_ys", t)

    def _behind(self, effect: str, rise: FloatArray) -> FloatArray:
        """By how much the temperature is ahead of itself through an effect's low-pass; it starts where the thermometer does."""
        if self._size(effect, "tau") <= 0.0:
            return np.zeros_like(rise)
        start = self._lagged_k.get(effect, float(rise[0]))
        keep = math.exp(-self._row_s / self._size(effect, "tau"))
        lagged, _ = lfilter([1.0 - keep], [1.0, -keep], rise, zi=[keep * start])
        self._lagged_k[effect] = float(lagged[-1])
        return np.asarray(rise - lagged)


def add_to_carrier(
    terms: SlowTerms, physics: FloatArray, drive: FloatArray, pick: FloatArray, omega_rad_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Put the terms of rows into what the carrier takes: ``physics`` in place; returns drive and pick-off, shape (rows, 8).

    ``p' = (i/2w) K p - (1/2) D p``: a frequency shift k is ``K += 2 w k + k^2``, a decay rate c is ``D += 2 c``.
    """
    k = terms.stiffness
    added = 2.0 * omega_rad_s[:, None, None] * k + k @ k
    physics[:, 0] += added[:, 0, 0]
    physics[:, 1] += added[:, 0, 1]
    physics[:, 2] += added[:, 1, 1]
    physics[:, 3:7] += 2.0 * terms.damping.reshape(-1, 4)
    driven = drive.view(np.complex128).reshape(-1, 2, 2) @ terms.drive
    picked = terms.pick @ pick.view(np.complex128).reshape(-1, 2, 2)
    return _flat(driven), _flat(picked)


def flow_with(terms: SlowTerms, A: ComplexArray, G: ComplexArray, pick: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """A and G of theory.md Eq. 4 with the terms of rows, shape (rows, 2, 2).

    Parameters
    ----------
    terms : SlowTerms
        Of the rows.
    A, G : ndarray, shape (rows, 2, 2), complex
        Of the device without these effects [1/s].
    pick : ndarray, shape (2, 2), complex
        P [V/m].
    """
    added = pick @ (1j * terms.stiffness - terms.damping) @ np.linalg.inv(pick)
    return np.asarray(terms.pick @ (A + added) @ np.linalg.inv(terms.pick)), np.asarray(terms.pick @ G @ terms.drive)


def kernel_rows(terms: SlowTerms, mode_omega_rad_s: FloatArray) -> FloatArray:
    """What the effect kernels take per row, shape (rows, N_ROW)."""
    rows = np.empty((mode_omega_rad_s.size, at.N_ROW))
    rows[:, at.R_FEED : at.R_MODE_OMEGA] = _flat(terms.feed)
    rows[:, at.R_MODE_OMEGA] = mode_omega_rad_s
    return rows


def _symmetric(same: FloatArray, split: FloatArray) -> FloatArray:
    """``same + split_c diag(1, -1) + split_s [[0, 1], [1, 0]]``, shape (rows, 2, 2)."""
    along, across = split[:, 0], split[:, 1]
    return np.stack([np.stack([same + along, across], axis=1), np.stack([across, same - along], axis=1)], axis=1)


def _flat(matrices: ComplexArray) -> FloatArray:
    return np.ascontiguousarray(matrices).reshape(len(matrices), 4).view(np.float64)
