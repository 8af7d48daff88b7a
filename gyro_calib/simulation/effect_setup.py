"""From the effects of a device to the numbers of the carrier: what its own fields can say goes there, the rest to the effect kernels."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..device import Device
from ..effects import EFFECTS
from ..errors import DeviceError
from . import effect_layout as at
from .effect_envelope import ENVELOPE_EFFECTS
from .effect_rows import SLOW_EFFECTS

__all__ = ["converter_constants", "kernel_constants", "nonlinear_coefficients", "refuse_without_envelope", "started_memory", "uses_kernel"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: effects that the numbers of the plain kernel can say: nonlinear forces, converters, per-row physics
_PLAIN = SLOW_EFFECTS | {
    "duffing",
    "duffing_axes",
    "cubic_cross_stiffness",
    "cubic_cross_stiffness_axes",
    "pickoff_nonlinearity",
    "pickoff_saturation",
    "pickoff_quantisation",
    "pickoff_gain_flicker",
    "pickoff_phase_flicker",
    "drive_gain_flicker",
    "loop_error",
    "angle_latency",
}


class _Sizes:
    """Sizes of a device's effects by ``effect.parameter``, zero (or what is said) where the device has no such effect."""

    def __init__(self, effects: Mapping[str, Mapping[str, float]]) -> None:
        self._effects = effects

    def __call__(self, effect: str, parameter: str, absent: float = 0.0) -> float:
        assert effect in EFFECTS
        return self._effects[effect][parameter] if effect in self._effects else absent


def uses_kernel(device: Device) -> bool:
    """Whether the samples must pass the effect kernels."""
    return bool(set(device.effects) - _PLAIN) or device.electronics.dac_bits > 0


def refuse_without_envelope(device: Device) -> None:
    """Refuse the slow flow of a device with effects that have no envelope form in it.

    Raises
    ------
    DeviceError
        Names the effects and the remedy.
    """
    # of a skew of microseconds P has all that the envelope shows
    here = (
        ENVELOPE_EFFECTS
        | SLOW_EFFECTS
        | {"duffing", "duffing_axes", "cubic_cross_stiffness", "cubic_cross_stiffness_axes", "multiplexing_skew"}
        | {"loop_error", "angle_latency"}
    )
    if device.multiplexing.enabled:  # a drive in slots bends at the volts of its slot
        here -= {name for name in here if name.startswith("drive_") and not name.endswith("_drift")}
    if device.drive.at_twice_frequency:  # a force besides the drives does not go with the motion
        here -= {"constant_force"}
    missing = sorted(set(device.effects) - here)
    if missing:
        raise DeviceError(
            f"Slow flow must have an envelope form of every effect of the device, but got {', '.join(missing)}. "
            "Simulate with fidelity carrier."
        )


def nonlinear_coefficients(device: Device) -> FloatArray:
    """Cubic forces of the device with those of its effects, as :func:`gyro_calib.device.averaging.instant_force` takes them, shape (8,).

    A force ``-k3 x^3`` shifts the frequency by ``(3/8) k3 a^2 / w``: ``k3 = (8/3) w k g^2`` for ``k a^2`` in pick-off volts, g in V/m.
    """
    size = _Sizes(device.effects)
    scale = 8.0 / 3.0 * device.resonator.omega0_rad_s * device.pickoff.gain_v_per_m**2
    cross = size("cubic_cross_stiffness", "k")
    added = [size("duffing", "k"), size("duffing_axes", "k_x"), size("duffing_axes", "k_y"), cross, cross, 0.0]
    coupled = [size("cubic_cross_stiffness_axes", name) for name in ("k_x", "k_y")]
    return np.concatenate([np.array(device.nonlinearity.coefficients) + scale * np.array(added), scale * np.array(coupled)])


def converter_constants(device: Device) -> FloatArray:
    """The converters as :func:`.carrier.carrier_rows` takes them, shape (8,)."""
    size = _Sizes(device.effects)
    e, cubic = device.electronics, device.pickoff.cubic_per_v2
    adc = 2.0 * e.adc_full_scale_v / 2**e.adc_bits if e.adc_bits else 0.0
    return np.array(
        [
            min(e.adc_full_scale_v, size("pickoff_saturation", "level", math.inf)),
            max(adc, size("pickoff_quantisation", "lsb")),
            e.dac_full_scale_v,
            _drive_step(device),
            cubic + 4.0 / 3.0 * size("pickoff_nonlinearity", "c_x"),
            *device.pickoff.per_gap_v,
            cubic + 4.0 / 3.0 * size("pickoff_nonlinearity", "c_y"),
        ]
    )


def kernel_constants(device: Device) -> FloatArray:
    """Numbers of the effect kernels, shape (N_EFFECT,)."""
    effect = np.zeros(at.N_EFFECT)
    size = _Sizes(device.effects)
    effect[at.E_PERIOD] = 1.0 / device.electronics.control_rate_hz
    effect[at.E_NOMINAL] = device.resonator.omega0_rad_s
    effect[at.E_HOLD] = np.sinc(device.resonator.frequency_hz / device.electronics.adc_rate_hz)
    _forces(effect, size, device.resonator.omega0_rad_s, device.pickoff.gain_v_per_m)
    _drive(effect, size, _drive_step(device))
    _pickoff(effect, size)
    return effect


def started_memory(effect: FloatArray, pick: ComplexArray, volts: ComplexArray, drive: ComplexArray, unpick: ComplexArray) -> FloatArray:
    """Memory of a device that has been at an operating point for ever, shape (N_MEMORY,).

    Parameters
    ----------
    effect : ndarray
        Of :func:`kernel_constants`.
    pick, volts, drive : ndarray, shape (2,), complex
        Pick-offs without and with feedthrough, drives [V].
    unpick : ndarray, shape (2, 2), complex
        Inverse of P [m/V].
    """
    memory = np.zeros(at.N_MEMORY)
    memory[at.M_LAG : at.M_LAG + 4] = memory[at.M_SLOW : at.M_SLOW + 4] = _parts(drive)
    memory[at.M_MOTION : at.M_MOTION + 4] = _parts(unpick @ pick)
    memory[at.M_OUT_LAG : at.M_OUT_LAG + 4] = memory[at.M_OUT_SLOW : at.M_OUT_SLOW + 4] = _parts(volts)
    memory[at.M_EARLY : at.M_EARLY + 4], memory[at.M_SOON : at.M_SOON + 4] = _parts(volts), _parts(drive)
    slow = 1.0 + effect[at.E_OUT_SLOW]
    memory[at.M_LAST : at.M_LAST + 2] = memory[at.M_SKEW : at.M_SKEW + 2] = slow * _parts(volts)[2:]
    return memory


def _drive_step(device: Device) -> float:
    e = device.electronics
    step = 2.0 * e.dac_full_scale_v / 2**e.dac_bits if e.dac_bits else 0.0
    return max(step, _Sizes(device.effects)("drive_quantisation", "lsb"))


def _forces(effect: FloatArray, size: _Sizes, w: float, gain: float) -> None:
    """Forces per mass from rates in pick-off volts; ``p' = -(i/2w) F``, a velocity's envelope is ``i w z``.

    ``|v|^2 v`` has the fundamental 3/4, ``|v| v`` has 8/(3 pi), ``v/|v|`` has 4/pi of its amplitude.
    """
    cubic = 8.0 / 3.0 * (gain / w) ** 2
    effect[at.E_VELOCITY] = cubic * size("nonlinear_damping", "c")
    effect[at.E_VELOCITY_X] = cubic * size("nonlinear_damping_axes", "c_x")
    effect[at.E_VELOCITY_Y] = cubic * size("nonlinear_damping_axes", "c_y")
    for of, name in ((at.E_VELOCITY_XY, "c_xy"), (at.E_VELOCITY_YX, "c_yx"), (at.E_VELOCITY_XXYY, "c_xxyy")):
        effect[of] = cubic * size("nonlinear_damping_axes", name)
    effect[at.E_DRAG] = 0.75 * math.pi * gain / w * size("quadratic_damping", "c")
    effect[at.E_FRICTION] = 0.5 * math.pi * w / gain * size("coulomb_friction", "c")
    effect[at.E_FRICTION_X] = 0.5 * math.pi * w / gain * size("coulomb_friction_axes", "c_x")
    effect[at.E_FRICTION_Y] = 0.5 * math.pi * w / gain * size("coulomb_friction_axes", "c_y")
    # stiffness Re[kappa e^{2 i phi}] gives p' = (i kappa/4w) p*: kappa = -4 i w (h_c + i h_s)
    for k, place in enumerate(("xs", "xc", "ys", "yc")):
        steady = size("parametric_pump", f"h_{place[1]}") + size("parametric_pump_axes", f"h_{place}")
        effect[at.E_PUMP + k], effect[at.E_DRIVEN_PUMP + k] = 4.0 * w * steady, 4.0 * w * size("driven_pump", f"h_{place}")
    # a stiffness kappa v^2 of both amplitudes gives p' = (i kappa/2w)(|u|^2 p/2 + u^2 p*/4)
    effect[at.E_SOFT_X], effect[at.E_SOFT_Y] = (8.0 * w * size("drive_stiffness", name) for name in ("k_x", "k_y"))
    effect[at.E_MEAN_X], effect[at.E_MEAN_Y] = (2.0 * w * size("drive_stiffness_mean", name) for name in ("k_x", "k_y"))
    # a force -2 w k J z gives p' = i k J p
    effect[at.E_CURL] = 2.0 * w * size("circulatory_stiffness", "k")
    effect[at.E_GAP_X], effect[at.E_GAP_Y] = (size("drive_gap", name) for name in ("d_x", "d_y"))
    effect[at.E_RELAX] = 2.0 * w * size("relaxation", "c")
    effect[at.E_RELAX_KEEP] = math.exp(-effect[at.E_PERIOD] / size("relaxation", "tau", 1.0))
    effect[at.E_CONSTANT : at.E_CONSTANT + 4] = [size("constant_force", name) for name in ("f_xc", "f_xs", "f_yc", "f_ys")]
    effect[at.E_MODE_HALF] = 2.0 * math.pi * size("spurious_mode", "half_width_hz")
    effect[at.E_MODE_XX : at.E_MODE_YY + 1] = [size("spurious_mode", f"gain_{place}") for place in ("xx", "xy", "yx", "yy")]
    effect[at.E_TONE_OMEGA] = 2.0 * math.pi * size("external_tone", "frequency_hz")
    effect[at.E_TONE_X], effect[at.E_TONE_Y] = size("external_tone", "a_x"), size("external_tone", "a_y")
    effect[at.E_TONE_PHASE] = size("external_tone", "phase_rad")
    effect[at.E_SPUR], effect[at.E_SPUR_OMEGA] = size("reference_spur", "s"), 2.0 * math.pi * size("reference_spur", "frequency_hz")


def _drive(effect: FloatArray, size: _Sizes, step_v: float) -> None:
    period = effect[at.E_PERIOD]
    effect[at.E_SAG] = size("drive_sag", "d")
    effect[at.E_PHASE_X], effect[at.E_PHASE_Y] = size("drive_amplitude_phase", "d_x"), size("drive_amplitude_phase", "d_y")
    effect[at.E_LATE_X], effect[at.E_LATE_Y] = size("drive_delay", "tau_x") / period, size("drive_delay", "tau_y") / period
    effect[at.E_LAG_KEEP], effect[at.E_LAG_MEAN] = _low_pass(period, size("drive_lag", "tau"))
    effect[at.E_SLOW] = size("drive_memory", "share")
    effect[at.E_SLOW_KEEP], effect[at.E_SLOW_MEAN] = _low_pass(period, size("drive_memory", "tau", 1.0))
    effect[at.E_CUBIC_X] = 4.0 / 3.0 * size("drive_nonlinearity", "d_x")
    effect[at.E_CUBIC_Y] = 4.0 / 3.0 * size("drive_nonlinearity", "d_y")
    effect[at.E_CROSS] = 4.0 / 3.0 * size("drive_cross_nonlinearity", "d")
    effect[at.E_CLIP] = size("drive_saturation", "level", math.inf)
    effect[at.E_DEAD], effect[at.E_STEP] = size("drive_dead_zone", "level"), step_v


def _pickoff(effect: FloatArray, size: _Sizes) -> None:
    period = effect[at.E_PERIOD]
    effect[at.E_STRAY : at.E_STRAY + 4] = [size("pickoff_interference", name) for name in ("v_xc", "v_xs", "v_yc", "v_ys")]
    effect[at.E_READ_X], effect[at.E_READ_Y] = size("pickoff_amplitude_phase", "c_x"), size("pickoff_amplitude_phase", "c_y")
    effect[at.E_READ_CROSS] = 4.0 / 3.0 * size("pickoff_cross_nonlinearity", "c")
    effect[at.E_HUM_OMEGA] = 2.0 * math.pi * size("mains_pickup", "frequency_hz")
    effect[at.E_HUM_X], effect[at.E_HUM_Y] = size("mains_pickup", "v_x"), size("mains_pickup", "v_y")
    # of a skew P has the phase (`Device.pickoff_matrix`)
    late_s = size("pickoff_delay", "tau_x"), size("pickoff_delay", "tau_y") + size("multiplexing_skew", "tau")
    effect[at.E_DELAY_X], effect[at.E_DELAY_Y] = late_s[0] / period, late_s[1] / period
    # a discrete low-pass v += keep (last - v) delays by keep/(1 - keep) periods
    lag, skew = size("pickoff_lag", "tau"), size("channel_skew", "tau")
    effect[at.E_OUT_KEEP] = lag / (lag + period)
    effect[at.E_OUT_SLOW] = size("pickoff_memory", "share")
    effect[at.E_OUT_SLOW_KEEP] = math.exp(-period / size("pickoff_memory", "tau", 1.0))
    effect[at.E_SKEW_KEEP] = max(skew, 0.0) / (max(skew, 0.0) + period)
    effect[at.E_SKEW_LEAD] = max(-skew, 0.0) / period
    # white up to the control rate: one-sided density s^2 is a variance s^2 / (2 period) of what is held over a period
    effect[at.E_GAIN] = size("amplitude_noise", "s") * math.sqrt(0.5 / period)


def _low_pass(period: float, tau: float) -> tuple[float, float]:
    """Share of its start that a low-pass under a held input keeps at the end of a period, and on average over it."""
    if tau <= 0.0:
        return 0.0, 0.0
    ratio = period / tau
    return math.exp(-ratio), -math.expm1(-ratio) / ratio


def _parts(values: ComplexArray) -> FloatArray:
    return np.array(values, dtype=complex).reshape(-1).view(np.float64)
