"""Effects of temperature, time, rotation and vibration.

T: above the resonator's reference, T_lp: the same through a first-order low-pass of time constant tau; t: since the start;
Omega: input rate.
"""

from __future__ import annotations

from ._short import BOTH, pair, positive, signed
from .effect import Effect

__all__ = ["ENVIRONMENT"]

_LAG = positive("tau", "s", 20.0, 1e4, "time constant of what warms late", lower=0.1)
_BEHIND = "(T - T_lp)"

THERMAL = (
    Effect(
        "thermal_damping", "Damping that follows the temperature", "environment", (28,),
        (signed("c", "1/s/K", 0.002, 1.0, "decay rate per kelvin, besides the law of the quality factor"),),
        ("temperature",), BOTH,
        "p' += -c T p",
        ("damping_drift", "thermal_drive_gain"),
    ),
    Effect(
        "thermal_damping_curvature", "Damping that bends with temperature", "environment", (28,),
        (signed("c", "1/s/K^2", 2e-4, 0.1, "decay rate per kelvin squared, besides the law of the quality factor"),),
        ("temperature",), BOTH,
        "p' += -c T^2 (D / mean D) p, D the damping, unequal as it is",
        ("thermal_damping_lag", "thermal_drive_gain_curvature"),
    ),
    Effect(
        "thermal_damping_anisotropy", "Damping anisotropy that follows the temperature", "environment", (2, 28),
        pair("c_c c_s", "1/s/K", 2e-4, 0.5, "decay rate per kelvin, by axis (c) and across (s)"),
        ("temperature",), BOTH,
        "p' += -T (c_c diag(1, -1) + c_s [[0, 1], [1, 0]]) p",
        ("thermal_drive_gain", "thermal_pickoff_gain"),
    ),
    Effect(
        "thermal_frequency_curvature", "Frequency that bends with temperature", "environment", (27,),
        (signed("k", "rad/s/K^2", 0.01, 10.0, "frequency per kelvin squared"),),
        ("temperature",), BOTH,
        "p' += i k T^2 p",
        ("thermal_lag", "duffing", "frequency_ageing"),
    ),
    Effect(
        "thermal_split", "Frequency split that follows the temperature", "environment", (1,),
        pair("k_c k_s", "rad/s/K", 0.003, 1.0, "half the split per kelvin, by axis (c) and across (s)"),
        ("temperature",), BOTH,
        "p' += i T (k_c diag(1, -1) + k_s [[0, 1], [1, 0]]) p",
        ("split_drift", "thermal_pickoff_phase"),
    ),
    Effect(
        "thermal_split_curvature", "Frequency split that bends with temperature", "environment", (1, 27),
        pair("k_c k_s", "rad/s/K^2", 3e-4, 0.1, "half the split per kelvin squared, by axis (c) and across (s)"),
        ("temperature",), BOTH,
        "p' += i T^2 (k_c diag(1, -1) + k_s [[0, 1], [1, 0]]) p",
        ("thermal_split", "thermal_split_lag"),
    ),
    Effect(
        "thermal_lag", "Resonator's temperature lags the sensor's", "environment", (30,),
        (positive("tau", "s", 30.0, 1e5, "time constant between the thermometer and what sets the frequency"),),
        ("temperature", "time"), BOTH,
        "p' += i TCF omega (T_lp - T) p, T_lp the temperature through a first-order low-pass of time constant tau",
        ("thermal_frequency_curvature", "frequency_ageing"),
    ),
    Effect(
        "thermal_frequency_lag", "A part of the frequency follows the temperature late", "environment", (27, 30),
        (signed("k", "rad/s/K", 0.01, 10.0, "frequency per kelvin of the lag"), _LAG),
        ("temperature", "time"), BOTH,
        f"p' += i k {_BEHIND} p",
        ("thermal_lag", "thermal_frequency_curvature", "thermal_split_lag"),
    ),
    Effect(
        "thermal_bias", "Bias that follows the temperature", "environment", (12, 38),
        (signed("b", "rad/s/K", 1e-5, 1.0, "apparent rate per kelvin"),),
        ("temperature",), BOTH,
        "p' += -kappa b T J p",
        ("thermal_damping_anisotropy", "thermal_bias_lag"),
    ),
    Effect(
        "thermal_drive_gain", "Drive gains that follow the temperature, by axis", "environment", (29,),
        pair("g_x g_y", "1/K", 2e-4, 0.05, "relative gain per kelvin"),
        ("temperature",), BOTH,
        "u_j += g_j T u_j",
        ("thermal_damping", "thermal_pickoff_gain"),
    ),
    Effect(
        "thermal_drive_phase", "Drive phases that follow the temperature", "environment", (19, 29),
        pair("g_x g_y", "rad/K", 1e-4, 0.05, "phase lead per kelvin"),
        ("temperature",), BOTH,
        "u_j += i g_j T u_j",
        ("thermal_pickoff_phase",),
    ),
    Effect(
        "thermal_pickoff_gain", "Pick-off gains that follow the temperature, by axis", "environment", (29,),
        pair("g_x g_y", "1/K", 2e-4, 0.05, "relative gain per kelvin"),
        ("temperature",), BOTH,
        "V_j += g_j T V_j",
        ("thermal_drive_gain", "thermal_damping_anisotropy"),
    ),
    Effect(
        "thermal_pickoff_phase", "Pick-off phases that follow the temperature", "environment", (19, 29),
        pair("g_x g_y", "rad/K", 1e-4, 0.05, "phase lead per kelvin"),
        ("temperature",), BOTH,
        "V_j += i g_j T V_j",
        ("thermal_drive_phase", "thermal_split"),
    ),
    Effect(
        "thermal_drive_coupling", "Drives that couple or rotate with the temperature", "environment", (11, 12, 29),
        pair("c_x c_y", "1/K", 2e-4, 0.05, "what acts on the axis of the other one's drive, per kelvin"),
        ("temperature",), BOTH,
        "u_j += c_j T u_k, k the other axis",
        ("thermal_bias", "thermal_damping_anisotropy", "thermal_pickoff_coupling"),
    ),
    Effect(
        "thermal_pickoff_coupling", "Pick-offs that couple or rotate with the temperature", "environment", (14, 15, 29),
        pair("c_x c_y", "1/K", 2e-4, 0.05, "what the axis reads of the other one, per kelvin"),
        ("temperature",), BOTH,
        "V_j += c_j T V_k, k the other axis",
        ("thermal_drive_coupling", "thermal_damping_anisotropy", "thermal_split"),
    ),
    Effect(
        "thermal_drive_gain_curvature", "Drive gains that bend with the temperature, by axis", "environment", (29,),
        pair("g_x g_y", "1/K^2", 1e-5, 5e-3, "relative gain per kelvin squared"),
        ("temperature",), BOTH,
        "u_j += g_j T^2 u_j",
        ("thermal_drive_gain", "thermal_drive_gain_lag", "thermal_pickoff_gain_curvature"),
    ),
    Effect(
        "thermal_pickoff_gain_curvature", "Pick-off gains that bend with the temperature, by axis", "environment", (29,),
        pair("g_x g_y", "1/K^2", 1e-5, 5e-3, "relative gain per kelvin squared"),
        ("temperature",), BOTH,
        "V_j += g_j T^2 V_j",
        ("thermal_pickoff_gain", "thermal_pickoff_gain_lag", "thermal_drive_gain_curvature"),
    ),
    Effect(
        "thermal_damping_lag", "Damping that follows the temperature late: hysteresis of the quality factor", "environment", (28, 30),
        (signed("c", "1/s/K", 0.002, 1.0, "decay rate per kelvin of the lag"), _LAG),
        ("temperature", "time"), BOTH,
        f"p' += -c {_BEHIND} p",
        ("thermal_damping", "damping_drift"),
    ),
    Effect(
        "thermal_damping_anisotropy_lag", "Damping anisotropy of a device that is not warm throughout", "environment", (2, 30),
        (*pair("c_c c_s", "1/s/K", 2e-4, 0.5, "decay rate per kelvin of the lag, by axis (c) and across (s)"), _LAG),
        ("temperature", "time"), BOTH,
        f"p' += -{_BEHIND} (c_c diag(1, -1) + c_s [[0, 1], [1, 0]]) p",
        ("thermal_damping_anisotropy", "thermal_drive_gain_lag", "thermal_pickoff_gain_lag"),
    ),
    Effect(
        "thermal_split_lag", "Frequency split of a device that is not warm throughout", "environment", (30,),
        (*pair("k_c k_s", "rad/s/K", 0.003, 1.0, "half the split per kelvin of the lag, by axis (c) and across (s)"), _LAG),
        ("temperature", "time"), BOTH,
        f"p' += i {_BEHIND} (k_c diag(1, -1) + k_s [[0, 1], [1, 0]]) p",
        ("thermal_split", "split_drift", "charge_accumulation"),
    ),
    Effect(
        "thermal_bias_lag", "Bias of a device that is not warm throughout: it follows the slope of the temperature", "environment", (30,),
        (signed("b", "rad/s/K", 1e-5, 1.0, "apparent rate per kelvin of the lag"), _LAG),
        ("temperature", "time"), BOTH,
        f"p' += -kappa b {_BEHIND} J p",
        ("thermal_bias", "thermal_damping_anisotropy_lag", "thermal_drive_gain_lag"),
    ),
    Effect(
        "thermal_drive_gain_lag", "Drive gains that follow the temperature late", "environment", (29, 30),
        (*pair("g_x g_y", "1/K", 2e-4, 0.05, "relative gain per kelvin of the lag"), _LAG),
        ("temperature", "time"), BOTH,
        f"u_j += g_j {_BEHIND} u_j",
        ("thermal_drive_gain", "thermal_damping_lag", "thermal_pickoff_gain_lag"),
    ),
    Effect(
        "thermal_pickoff_gain_lag", "Pick-off gains that follow the temperature late", "environment", (29, 30),
        (*pair("g_x g_y", "1/K", 2e-4, 0.05, "relative gain per kelvin of the lag"), _LAG),
        ("temperature", "time"), BOTH,
        f"V_j += g_j {_BEHIND} V_j",
        ("thermal_pickoff_gain", "thermal_drive_gain_lag"),
    ),
    Effect(
        "thermal_feedthrough", "Feedthrough that follows the temperature", "environment", (21,),
        pair("e_x e_y", "1/K", 2e-5, 0.01, "direct feedthrough of the axis' own drive per kelvin"),
        ("temperature", "open drive"), BOTH,
        "V_j += e_j T u_j",
        ("thermal_drive_phase",),
    ),
)  # fmt: skip

TIME = (
    Effect(
        "frequency_ageing", "Frequency that drifts with time", "environment", (31,),
        (signed("k", "rad/s/s", 1e-4, 1.0, "frequency per second"),),
        ("time",), BOTH,
        "p' += i k t p",
        ("charge_accumulation", "thermal_lag"),
    ),
    Effect(
        "damping_drift", "Damping that drifts with time (leak)", "environment", (31, 49),
        (signed("c", "1/s/s", 1e-5, 0.1, "decay rate per second"),),
        ("time",), BOTH,
        "p' += -c t p",
        ("drive_gain_drift", "thermal_damping"),
    ),
    Effect(
        "bias_drift", "Bias that drifts with time", "environment", (31, 38, 50),
        (signed("b", "rad/s/s", 1e-7, 0.1, "apparent rate per second"),),
        ("time",), BOTH,
        "p' += -kappa b t J p",
        ("thermal_bias", "damping_drift"),
    ),
    Effect(
        "split_drift", "Frequency split that drifts with time", "environment", (31,),
        pair("k_c k_s", "rad/s/s", 1e-5, 0.1, "half the split per second, by axis (c) and across (s)"),
        ("time",), BOTH,
        "p' += i t (k_c diag(1, -1) + k_s [[0, 1], [1, 0]]) p",
        ("charge_accumulation", "thermal_split"),
    ),
    Effect(
        "charge_accumulation", "Charge builds up on dielectrics and moves stiffness and split", "environment", (32,),
        (
            signed("k_c", "rad/s", 0.05, 50.0, "final change of half the split, by axis"),
            signed("k_s", "rad/s", 0.05, 50.0, "final change of half the split, across"),
            signed("k_0", "rad/s", 0.05, 50.0, "final change of the frequency"),
            positive("tau", "s", 300.0, 1e7, "time constant", lower=0.1),
        ),
        ("time",), BOTH,
        "p' += i (1 - e^(-t/tau)) (k_0 + k_c diag(1, -1) + k_s [[0, 1], [1, 0]]) p",
        ("split_drift", "frequency_ageing"),
    ),
    Effect(
        "drive_gain_drift", "Drive gains that drift with time", "environment", (31, 45),
        pair("g_x g_y", "1/s", 5e-6, 0.01, "relative gain per second"),
        ("time",), BOTH,
        "u_j += g_j t u_j",
        ("damping_drift", "pickoff_gain_drift"),
    ),
    Effect(
        "drive_phase_drift", "Drive phases that drift with time", "environment", (31, 45),
        pair("g_x g_y", "rad/s", 2e-6, 0.01, "phase lead per second"),
        ("time",), BOTH,
        "u_j += i g_j t u_j",
        ("frequency_ageing", "split_drift", "pickoff_phase_drift"),
    ),
    Effect(
        "pickoff_gain_drift", "Pick-off gains that drift with time", "environment", (31, 45),
        pair("g_x g_y", "1/s", 5e-6, 0.01, "relative gain per second"),
        ("time",), BOTH,
        "V_j += g_j t V_j",
        ("drive_gain_drift",),
    ),
    Effect(
        "pickoff_phase_drift", "Pick-off phases that drift with time", "environment", (19, 31, 45),
        pair("g_x g_y", "rad/s", 2e-6, 0.01, "phase lead per second"),
        ("time",), BOTH,
        "V_j += i g_j t V_j",
        ("drive_phase_drift", "split_drift"),
    ),
    Effect(
        "drive_coupling_drift", "Drives that couple or rotate as time passes", "environment", (11, 12, 31),
        pair("c_x c_y", "1/s", 5e-6, 0.01, "what acts on the axis of the other one's drive, per second"),
        ("time",), BOTH,
        "u_j += c_j t u_k, k the other axis",
        ("bias_drift", "pickoff_coupling_drift", "cross_feedthrough_drift"),
    ),
    Effect(
        "pickoff_coupling_drift", "Pick-offs that couple or rotate as time passes", "environment", (14, 15, 31),
        pair("c_x c_y", "1/s", 5e-6, 0.01, "what the axis reads of the other one, per second"),
        ("time",), BOTH,
        "V_j += c_j t V_k, k the other axis",
        ("drive_coupling_drift", "split_drift", "bias_drift"),
    ),
    Effect(
        "feedthrough_drift", "Feedthrough of an axis' own drive that drifts with time", "environment", (21, 31),
        (*pair("e_xc e_xs", "1/s", 2e-7, 0.01, "of x per second"), *pair("e_yc e_ys", "1/s", 2e-7, 0.01, "of y per second")),
        ("time", "open drive"), BOTH,
        "V_j += (e_jc + i e_js) t u_j",
        ("pickoff_phase_drift", "pickoff_gain_drift", "cross_feedthrough_drift"),
    ),
    Effect(
        "cross_feedthrough_drift", "Feedthrough of the other axis' drive that drifts with time", "environment", (22, 31),
        (*pair("e_xc e_xs", "1/s", 2e-7, 0.01, "to x per second"), *pair("e_yc e_ys", "1/s", 2e-7, 0.01, "to y per second")),
        ("time", "open drive"), BOTH,
        "V_j += (e_jc + i e_js) t u_k, k the other axis",
        ("feedthrough_drift", "bias_drift", "split_drift"),
    ),
)  # fmt: skip

MOTION = (
    Effect(
        "centrifugal_stiffness", "Stiffness that changes with the square of the rate", "environment", (40,),
        (signed("k", "rad/s/(rad/s)^2", 0.01, 100.0, "frequency per rate squared"),),
        ("rate",), BOTH,
        "p' += i k Omega^2 p",
        ("rate_nonlinearity", "centrifugal_stiffness_axes"),
    ),
    Effect(
        "centrifugal_stiffness_axes", "Stiffness that changes with the square of the rate, by axis", "environment", (40,),
        (
            *pair("k_x k_y", "rad/s/(rad/s)^2", 0.01, 100.0, "frequency of a wave on the axis per rate squared"),
            signed("k_s", "rad/s/(rad/s)^2", 0.01, 100.0, "half the split across the axes per rate squared"),
        ),
        ("rate",), BOTH,
        "p_j' += i (k_j p_j + k_s p_k) Omega^2, k the other axis",
        ("centrifugal_stiffness", "thermal_split_lag"),
    ),
    Effect(
        "rate_dependent_damping", "Damping that changes with the rate", "environment", (42,),
        (signed("c", "1/s/(rad/s)", 0.005, 1.0, "decay rate per rate"),),
        ("rate",), BOTH,
        "p' += -c Omega p",
        ("angular_gain_error",),
    ),
    Effect(
        "angular_gain_error", "Angular gain differs from the factory's", "environment", (41,),
        (signed("e", "1", 1e-3, 0.2, "relative excess of the angular gain"),),
        ("rate",), BOTH,
        "p' += -e kappa Omega J p",
        ("rate_nonlinearity",),
    ),
    Effect(
        "rate_nonlinearity", "Response not proportional to the rate", "environment", (42,),
        (signed("e", "s/rad", 1e-3, 1.0, "relative excess of the angular gain per rate"),),
        ("rate", "rates"), BOTH,
        "p' += -e kappa Omega |Omega| J p",
        ("angular_gain_error", "rate_asymmetry"),
    ),
    Effect(
        "rate_asymmetry", "Response to one sense of rotation larger than to the other", "environment", (42,),
        (signed("e", "s/rad", 1e-3, 1.0, "relative excess of the angular gain per rate, signed"),),
        ("rate",), BOTH,
        "p' += -e kappa Omega^2 J p",
        ("angular_gain_error", "rate_nonlinearity"),
    ),
    Effect(
        "base_sway", "Base that sways: a rate at one frequency", "environment", (37, 38, 50),
        (
            positive("frequency_hz", "Hz", 2.0, 1000.0, "frequency of the sway", lower=0.01),
            positive("r", "rad/s", 1e-4, 1.0, "its rate's amplitude"),
            signed("phase_rad", "rad", 1.0, 6.2832, "phase of its cosine at device time 0"),
        ),
        ("time",), BOTH,
        "p' += -kappa r cos(2 pi frequency t + phase) J p, t the device time",
        ("bias_drift",),
    ),
    Effect(
        "external_tone", "Vibration or mains force at one frequency near the resonance", "environment", (37,),
        (
            positive("frequency_hz", "Hz", 15010.0, 1e6, "absolute frequency", lower=1.0),
            signed("a_x", "V", 1e-3, 10.0, "on x, in volts of drive"),
            signed("a_y", "V", 1e-3, 10.0, "on y, in volts of drive"),
            signed("phase_rad", "rad", 1.0, 6.2832, "phase of its cosine at device time 0"),
        ),
        ("time",), BOTH,
        "u_j += a_j e^(i (2 pi frequency t + phase - phi)), phi the phase reference",
        ("mains_pickup", "constant_force"),
    ),
)  # fmt: skip

ENVIRONMENT = (*THERMAL, *TIME, *MOTION)
