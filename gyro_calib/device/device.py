"""A device: resonator, chains, electronics, noise and surroundings; its slow flow in closed form (theory.md Eqs. 3-4)."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects import checked_sizes
from ..errors import DeviceError
from .chains import DriveChain, Feedthrough, PickoffChain
from .electronics import SLOTS, Electronics, Environment, Loops, Multiplexing, Noise
from .resonator import J, Nonlinearity, Resonator

__all__ = ["Device", "FactoryData", "SlowFlow"]

ComplexArray = NDArray[np.complex128]
#: modes that give a rate
MISSION_MODES = ("ftr_x", "ftr_y", "whole_angle")


@dataclass(frozen=True)
class SlowFlow:
    """``p' = (A - i (omega - omega0)) p + G u``, ``V = p + E u``.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        [1/s], [1/s], dimensionless; rows are pick-offs x, y.
    omega0_rad_s : float
        Frequency about which A is written [rad/s].
    dA_dOmega : ndarray, shape (2, 2), complex
        Derivative of A with the input rate, dimensionless.
    """

    A: ComplexArray
    G: ComplexArray
    E: ComplexArray
    omega0_rad_s: float
    dA_dOmega: ComplexArray


@dataclass(frozen=True)
class FactoryData:
    """What left the factory with the unit; everything a calibrator may know in advance.

    Parameters
    ----------
    kind : str
        ``"ring"``, ``"disk"``, ``"hrg"``.
    angular_gain_kappa, nominal_f0_hz, nominal_q : float
        As measured or designed.
    drive_gain_ratio_x_over_y : float
        rho of theory.md section 5; NaN when it was not measured.
    nominal_scale_factor_x_v_per_rad_s, nominal_scale_factor_y_v_per_rad_s : float
        What the firmware divides the rebalance volts by, by oscillator axis, at ``nominal_amplitude_v``.
    nominal_amplitude_v : float
        Amplitude of the mission [V].
    mission_mode : str
        What the gyro runs in when nobody calibrates it: ``"ftr_x"``, ``"ftr_y"`` or ``"whole_angle"``.
    """

    kind: str
    angular_gain_kappa: float
    nominal_f0_hz: float
    nominal_q: float
    nominal_scale_factor_x_v_per_rad_s: float
    nominal_scale_factor_y_v_per_rad_s: float
    drive_gain_ratio_x_over_y: float = math.nan
    nominal_amplitude_v: float = 1.0
    mission_mode: str = "ftr_x"

    def __post_init__(self) -> None:
        if self.mission_mode not in MISSION_MODES:
            raise DeviceError(f"FactoryData mission_mode must be one of {', '.join(MISSION_MODES)}, but got {self.mission_mode!r}.")

    def nominal_scale_factor(self, axis: str, amplitude_v: float) -> float:
        """Rebalance volts per rad/s that the firmware assumes with ``axis`` as the oscillator at ``amplitude_v`` [V/(rad/s)]."""
        nominal = self.nominal_scale_factor_x_v_per_rad_s if axis == "x" else self.nominal_scale_factor_y_v_per_rad_s
        return nominal * amplitude_v / self.nominal_amplitude_v


@dataclass(frozen=True)
class Device:
    """A gyro as it truly is.

    Parameters
    ----------
    device_id : str
        Identity of the unit.
    factory_data : FactoryData
        What a calibrator may know.
    resonator, drive, pickoff, feedthrough, nonlinearity, electronics, multiplexing, loops, noise, environment
        Its parts.
    effects : mapping
        Effects that the linear model leaves out: name -> parameter -> size, of the catalogue :data:`gyro_calib.effects.EFFECTS`.
    """

    device_id: str
    factory_data: FactoryData
    resonator: Resonator
    drive: DriveChain
    pickoff: PickoffChain
    electronics: Electronics
    feedthrough: Feedthrough = field(default_factory=Feedthrough)
    nonlinearity: Nonlinearity = field(default_factory=Nonlinearity)
    multiplexing: Multiplexing = field(default_factory=Multiplexing)
    loops: Loops = field(default_factory=Loops)
    noise: Noise = field(default_factory=Noise)
    environment: Environment = field(default_factory=Environment)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if not self.device_id:
            raise DeviceError("Device device_id must be a non-empty text, but got ''.")
        object.__setattr__(self, "effects", checked_sizes(self.effects))
        samples = self.electronics.adc_rate_hz / self.resonator.frequency_hz
        if samples < 8.0:
            raise DeviceError(
                f"Device electronics.adc_rate_hz must give 8 or more samples per carrier cycle, but got {samples:.3g}. Raise adc_rate_hz."
            )

    def temperature_rise(self, temperature_degc: float) -> float:
        """Temperature above the resonator's reference [K]."""
        return temperature_degc - self.resonator.reference_temperature_degc

    def pickoff_matrix(self, temperature_rise_k: float = 0.0) -> ComplexArray:
        """P as the demodulator sees it [V/m], shape (2, 2): the chain with the delay, the skew and the crosstalk of its multiplexer."""
        pick = self.pickoff.matrix(temperature_rise_k)
        if skew := self.effects.get("multiplexing_skew"):
            pick = np.diag([1.0, cmath.exp(-1j * self.resonator.omega0_rad_s * skew["tau"])]) @ pick
        if not self.multiplexing.enabled:
            return pick
        lag = cmath.exp(-1j * self.resonator.omega0_rad_s * self.multiplexing.delay_s)
        share = self.multiplexing.crosstalk
        return np.asarray(lag * np.array([[1.0, share], [share, 1.0]]) @ pick, dtype=complex)

    def feedthrough_matrix(self) -> ComplexArray:
        """E, shape (2, 2): zero where drives and readings do not meet, in time (multiplexer) or in frequency (drive at twice it)."""
        if self.multiplexing.enabled or self.drive.at_twice_frequency:
            return np.zeros((2, 2), dtype=complex)
        return self.feedthrough.matrix()

    @property
    def loop_latency_s(self) -> float:
        """Time from the centre of what a control step has measured to the centre of the drive that answers it [s], by design.

        Multiplexed: mean over the azimuth. The x drive answers x after five slots and y after three, the y drive x after three and y after
        one; the direction of the drive across the wave lags by ``1 + 4 sin^4 psi + sin^2(2 psi) / 2`` slots.
        """
        n = self.electronics.samples_per_control
        samples = (0.75 * SLOTS * n + 0.5) if self.multiplexing.enabled else 2.0 * n - 0.5
        return samples / self.electronics.adc_rate_hz

    @property
    def angle_latency_s(self) -> float:
        """By how much more than the loops' design the drives' direction is late [s]: an effect."""
        return self.effects.get("angle_latency", {}).get("tau", 0.0)

    def drive_factor(self, pick_v: ComplexArray) -> float:
        """Force per volt of the drive at pick-off envelopes over that of its gains: 1 unless the drives are at twice the frequency."""
        if not self.drive.at_twice_frequency:
            return 1.0
        motion = np.linalg.solve(self.pickoff_matrix(self.temperature_rise(self.environment.temperature_degc)), pick_v)
        return float(np.linalg.norm(motion)) * self.drive_factor_per_m

    @property
    def drive_factor_per_m(self) -> float:
        """Factor of the drive per metre of motion, of drives at twice the frequency [1/m]: one at the nominal amplitude."""
        return self.pickoff.gain_v_per_m / self.factory_data.nominal_amplitude_v

    def slow_flow(self, rate_rad_s: float = 0.0, temperature_degc: float | None = None, omega_rad_s: float | None = None) -> SlowFlow:
        """A, G, E of theory.md Eq. 4 at ``rate_rad_s`` and ``temperature_degc``, about ``omega_rad_s`` (default: the natural frequency).

        With the actual reference frequency the steady state is exact; elsewhere it is the first order of averaging.
        The zero-order hold of the drive scales G by sinc(f T); its delay of half a sample is taken back by the firmware's phase advance.
        """
        t = self.environment.temperature_degc if temperature_degc is None else temperature_degc
        rise = self.temperature_rise(t)
        omega = 2.0 * math.pi * self.resonator.frequency_at(t) if omega_rad_s is None else omega_rad_s
        pick = self.pickoff_matrix(rise)
        inverse = np.linalg.inv(pick)
        stiffness = self.resonator.stiffness_matrix(t) - omega**2 * np.eye(2)
        inner = -0.5 * self.resonator.damping_matrix(t) + 0.5j / omega * stiffness
        coriolis = pick @ (-self.resonator.angular_gain * J) @ inverse
        hold = np.sinc(omega / (2.0 * math.pi) / self.electronics.adc_rate_hz)
        gain = -0.5j / omega * hold * pick @ self.drive.matrix(rise)
        return SlowFlow(
            A=np.asarray(pick @ inner @ inverse + rate_rad_s * coriolis, dtype=complex),
            G=gain,
            E=self.feedthrough_matrix(),
            omega0_rad_s=omega,
            dA_dOmega=coriolis,
        )

    def factory(self) -> dict[str, Any]:
        """Factory data in the form that recordings and the driver carry."""
        f = self.factory_data
        data: dict[str, Any] = {
            "unit": self.device_id,
            "kind": f.kind,
            "angular_gain_kappa": f.angular_gain_kappa,
            "nominal_f0_hz": f.nominal_f0_hz,
            "nominal_q": f.nominal_q,
            "reference_temperature_degC": self.resonator.reference_temperature_degc,
            # drives are recorded as their means
            "dac_full_scale_V": self.electronics.dac_full_scale_v * self.multiplexing.drive_share,
            "adc_full_scale_V": self.electronics.adc_full_scale_v,
            "nominal_scale_factor_v_per_rad_s": {
                "x": f.nominal_scale_factor_x_v_per_rad_s,
                "y": f.nominal_scale_factor_y_v_per_rad_s,
            },
            "nominal_amplitude_v": f.nominal_amplitude_v,
            "mission_mode": f.mission_mode,
            "dac_zero_order_hold_s": 1.0 / self.electronics.adc_rate_hz,
            "control_rate_hz": self.electronics.control_rate_hz,
            "loop_latency_s": self.loop_latency_s,
        }
        if self.drive.at_twice_frequency:
            data["drive_at_twice_frequency"] = True
        if math.isfinite(f.drive_gain_ratio_x_over_y):
            data["drive_gain_ratio_x_over_y"] = f.drive_gain_ratio_x_over_y
        return data
