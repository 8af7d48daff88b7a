"""The rate in the mission: the calibrated slow flow inverted row by row (document 000, "determine the angular rate of the gyroscope during
a mission based on Equations 3, 4, 7 and 8"), following the operating point away from where it was calibrated.

With everything about the frequency omega0 of the calibration, s = omega/omega0 and p = V - E u, theory.md Eq. 3 reads, second order in
1/omega kept as in :mod:`gyro_calib.estimation.projection`,

    s p' + i delta p = (d s Re A~ + i Im A~) p + Omega s A1 p + g G h u + c |V|^2 V,       A~: A at rest, freed of the pick-off phase,

and the row of the closed axis gives Omega: the document's Eq. 8 with its "tight secondary feedback loop V_y = 0" replaced by the V_y that
was measured. What the operating point does to it:

* amplitude: p is measured; nothing assumes the set point. Cubic terms c count with the square that is there.
* frequency: s on the Coriolis force and on the damping (the scale factor goes with omega); h, the converter hold at omega.
* damping: d, from the power balance of the oscillator: what its drive now puts in against what the calibration says it takes. D is taken
  to scale as a whole, and the share that need not is in the variance.
* gain: g of drive and pick-off together is not observable in the mission (d and g enter the oscillator as d/g). It follows a known
  coefficient per kelvin, or stays 1; an error of g then costs scale factor but no bias, and its uncertainty grows with the distance in
  temperature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ..errors import DataError
from ..estimation.projection import hold_factor
from ..estimation.separation import PickoffFrame, angular_response
from ..recording.recording import Recording
from .record import CalibrationRecord

__all__ = ["Drifts", "MissionRate", "mission_rate"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Drifts:
    """How a unit moves with temperature since its calibration: known coefficients and how unsure they are.

    Defaults are engineering estimates (effects.md row 29: 100 ppm/K of a gain), not fitted to any device.

    Parameters
    ----------
    gain_per_k, gain_per_k_sd : float
        Relative change of the product of drive and pick-off gain [1/K].
    ratio_per_k_sd : float
        Of the pick-off ratio r [1/K].
    phase_per_k_sd : float
        Of the relative electronics phase [rad/K].
    damping_unevenness : float
        Share of a change of damping that may be unlike on the two axes, standard deviation.
    balance_s : float
        The oscillator's power balance is averaged over this [s].
    """

    gain_per_k: float = 0.0
    gain_per_k_sd: float = 150e-6
    ratio_per_k_sd: float = 20e-6
    phase_per_k_sd: float = 10e-6
    damping_unevenness: float = 0.1
    balance_s: float = 1.0


@dataclass(frozen=True)
class MissionRate:
    """Rate of every row.

    Parameters
    ----------
    rate_rad_s, variance : ndarray, shape (n,)
        Rate [rad/s] and its variance [(rad/s)^2]: noise of one row (pick-off noise grows with frequency: more than the angle random walk),
        calibration, drift of the operating point.
    systematic_sd_rad_s : ndarray, shape (n,)
        The part that averaging over rows does not reduce: calibration and drift [rad/s].
    damping_ratio : ndarray, shape (n,)
        d, damping over that at calibration.
    temperature_rise_k : ndarray, shape (n,)
        Since the calibration.
    record_id : str
    """

    rate_rad_s: FloatArray
    variance: FloatArray
    systematic_sd_rad_s: FloatArray
    damping_ratio: FloatArray
    temperature_rise_k: FloatArray
    record_id: str


def mission_rate(recording: Recording, record: CalibrationRecord, *, drifts: Drifts | None = None) -> MissionRate:
    """Invert the slow flow of a force-rebalance recording.

    Parameters
    ----------
    recording : Recording
        Mode ``ftr_x`` or ``ftr_y``, any amplitude, temperature and modulation.
    record : CalibrationRecord
        Of a side-band calibration of the same unit: its parameters hold the slow flow.
    drifts : Drifts, optional
        What is known of the unit's coefficients.

    Raises
    ------
    DataError
        Another device, a mode without a rebalanced axis, fewer than three rows, or a record without a slow flow.
    """
    drifts = drifts or Drifts()
    flow = _Flow.of(record)
    _check(recording, record)
    osc = 0 if recording.command.mode == "ftr_x" else 1
    rise = recording.temperature_degc - record.temperature_degc.value
    terms = _Terms.of(recording, flow, 1.0 + drifts.gain_per_k * rise, 1 - osc)
    width = max(1, round(drifts.balance_s * recording.sample_rate_hz))
    # the oscillator: what lies along its motion is power and gives the damping, what lies across it the distance from resonance
    moved, damped, rate = terms.moved[:, osc], terms.along(-terms.damp), np.zeros(len(recording))
    for _ in range(2):  # the second time without what non-orthogonal pick-offs see of the rate itself
        ratio = (terms.slope - terms.force - terms.stiff - rate[:, None] * terms.turn)[:, osc] / moved
        needed = terms.damp[:, osc] / moved
        d = _mean(ratio.real, width) / _mean(needed.real, width)
        delta = _mean((d * needed - ratio).imag, width)
        # the closed axis: what lies along the response to rate
        rest = terms.slope[:, 1 - osc] + 1j * delta * terms.moved[:, 1 - osc] - terms.stiff[:, 1 - osc]
        rate = terms.along_closed(rest) + terms.along(-terms.force) + d * damped
    fixed = _calibration_variance(record, recording.command.mode, rate)
    fixed += (drifts.gain_per_k_sd**2 + drifts.ratio_per_k_sd**2) * (rise * rate) ** 2
    fixed += (drifts.damping_unevenness * (d - 1.0) * damped) ** 2
    fixed += (drifts.phase_per_k_sd * rise * terms.across(terms.stiff)) ** 2
    # motion that is slow against a row cancels in second differences; white noise of variance v has 6 v there
    measured = float(np.mean(np.diff(rate, 2) ** 2)) / 6.0
    white = max(measured, 0.5 * record.rate_noise_density.value**2 * recording.sample_rate_hz)
    return MissionRate(rate, white + fixed, np.sqrt(fixed), d, rise, record.record_id)


def _check(recording: Recording, record: CalibrationRecord) -> None:
    if recording.device_id != record.device_id:
        raise DataError(
            f"Record must belong to device {recording.device_id!r}, but got {record.record_id!r} of {record.device_id!r}. "
            "Load its own record."
        )
    if recording.command.oscillator_axis is None:
        raise DataError(f"Mode must be ftr_x or ftr_y for a rebalanced rate, but got {recording.command.mode!r}.")
    if len(recording) < 3:
        raise DataError(f"Recording must hold three rows or more, but got {len(recording)}.")


@dataclass(frozen=True)
class _Flow:
    """The slow flow of a record, about its reference frequency; ``A`` at rest split in stiffness (i Im A~) and damping (Re A~)."""

    omega0_rad_s: float
    stiffness: ComplexArray
    damping: ComplexArray
    response: ComplexArray
    G: ComplexArray
    E: ComplexArray
    cubic: ComplexArray

    @classmethod
    def of(cls, record: CalibrationRecord) -> _Flow:
        q = {name: quantity.value for name, quantity in record.parameters.items()}
        try:
            A, G, E = (_matrix(q, name) for name in "AGE")
            frame = PickoffFrame(q["pickoff_ratio"], 2.0 * q["pickoff_non_orthogonality"], q["pickoff_phase"], (0.0, 0.0, 0.0))
            amplitude, frequency = record.operating_point["amplitude_v"], record.operating_point["ref_freq_hz"]
            # theory.md Eq. 7 of both axes: the ratio cancels in the product
            scales = record.scale_factor_by_axis["x"].value * record.scale_factor_by_axis["y"].value
        except KeyError as error:
            raise DataError(
                f"Record {record.record_id!r} must hold the slow flow of a side-band calibration, but lacks {error.args[0]}. "
                "Calibrate again."
            ) from error
        kappa = math.sqrt(abs(scales * G[0, 0] * G[1, 1])) / amplitude
        response = angular_response(frame, kappa)
        bare = frame.without_phase(A - record.rate.value * response)
        turn = np.exp(1j * frame.phase_rad)
        phases = np.array([[1.0, 1.0 / turn], [turn, 1.0]])
        cubic = _matrix(q, "cubic") if "cubic_xx_re" in q else np.zeros((2, 2), dtype=complex)
        return cls(2.0 * math.pi * frequency, 1j * bare.imag * phases, bare.real * phases, response, G, E, cubic)


def _matrix(values: dict[str, float], name: str) -> ComplexArray:
    return np.array([[values[f"{name}_{i}{j}_re"] + 1j * values[f"{name}_{i}{j}_im"] for j in "xy"] for i in "xy"])


@dataclass(frozen=True)
class _Terms:
    """Each term of the slow flow at every row, both axes, shape (n, 2); ``turn`` per rad/s; ``unit`` makes a rate of the closed axis'."""

    moved: ComplexArray
    slope: ComplexArray
    force: ComplexArray
    stiff: ComplexArray
    damp: ComplexArray
    turn: ComplexArray
    unit: ComplexArray
    closed: int

    @classmethod
    def of(cls, recording: Recording, flow: _Flow, gain: FloatArray, closed: int) -> _Terms:
        omega = recording.ref_omega_rad_s
        stretch = (omega / flow.omega0_rad_s)[:, None]
        volts, drive = recording.pick, recording.drive
        moved = volts - drive @ flow.E.T
        acting = drive * hold_factor(recording, omega, flow.omega0_rad_s)[:, None]
        turn = stretch * (moved @ flow.response.T)
        return cls(
            moved=moved,
            slope=stretch * np.gradient(moved, 1.0 / recording.sample_rate_hz, axis=0),
            force=gain[:, None] * (acting @ flow.G.T) + (np.abs(volts) ** 2 * volts) @ flow.cubic.T,
            stiff=moved @ flow.stiffness.T,
            damp=stretch * (moved @ flow.damping.T),
            turn=turn,
            unit=turn[:, closed].conj() / np.abs(turn[:, closed]) ** 2,
            closed=closed,
        )

    def along_closed(self, signal: ComplexArray) -> FloatArray:
        """Rate that a signal of the closed axis amounts to, shape (n,)."""
        return np.asarray((signal * self.unit).real)

    def along(self, term: ComplexArray) -> FloatArray:
        """Rate that a term amounts to on the closed axis."""
        return self.along_closed(term[:, self.closed])

    def across(self, term: ComplexArray) -> FloatArray:
        """Its part in quadrature, which a phase error turns into rate."""
        return np.asarray((term[:, self.closed] * self.unit).imag)


def _mean(values: FloatArray, width: int) -> FloatArray:
    return np.asarray(uniform_filter1d(values, width, mode="nearest"))


def _calibration_variance(record: CalibrationRecord, mode: str, rate: FloatArray) -> FloatArray:
    """Variance of bias and scale factor at the operating point of the calibration [(rad/s)^2]."""
    if mode == record.mode:
        c1, c2 = 2.0 * record.bias_scale_covariance, record.scale_factor.sd**2
        return np.asarray((record.bias.sd**2 + rate * (c1 + c2 * rate)) / record.scale_factor.value**2)
    axis = mode[-1]
    bias, scale = record.bias_by_axis[axis], record.scale_factor_by_axis[axis]
    return np.asarray(bias.sd**2 + (rate * scale.sd / scale.value) ** 2)
