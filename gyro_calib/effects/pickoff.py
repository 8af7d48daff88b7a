"""Effects between the motion and the recorded pick-off."""

from __future__ import annotations

from ._short import BOTH, pair, positive, signed
from .effect import Effect

__all__ = ["PICKOFF"]

PICKOFF = (
    Effect(
        "pickoff_nonlinearity", "Pick-off voltage not proportional to the motion", "pick-off", (16,),
        pair("c_x c_y", "1/V^2", 0.002, 0.5, "relative growth of the reading per amplitude squared"),
        ("amplitudes",), BOTH,
        "V_j += c_j |V_j|^2 V_j; per sample v (1 + (4/3) c v^2)",
        ("nonlinear_damping_axes", "pickoff_saturation", "drive_nonlinearity"),
    ),
    Effect(
        "pickoff_amplitude_phase", "Phase of the pick-off that depends on the amplitude", "pick-off", (16, 19),
        pair("c_x c_y", "rad/V^2", 0.002, 0.5, "phase lead per amplitude squared"),
        ("amplitudes",), BOTH,
        "V_j += i c_j |V_j|^2 V_j",
        ("duffing_axes", "pickoff_nonlinearity"),
    ),
    Effect(
        "pickoff_saturation", "Pick-off amplifier clips", "pick-off", (25,),
        (positive("level", "V", 1.2, 100.0, "largest carrier voltage of either axis", lower=1e-3),),
        ("amplitudes",), BOTH,
        "carrier voltage held within +-level before the converter",
        ("pickoff_nonlinearity", "nonlinear_damping"),
    ),
    Effect(
        "pickoff_lag", "Pick-off lags the motion", "pick-off", (18, 20),
        (positive("tau", "s", 1e-4, 0.05, "delay of the envelope; the phase of the carrier is that of the chain"),),
        ("side bands",), BOTH,
        "V += -tau dV/dt, exactly: V through a first-order low-pass of delay tau",
        ("drive_lag", "channel_skew"),
    ),
    Effect(
        "pickoff_delay", "Pick-off's carrier is late: an analog filter, a cable, a slot", "pick-off", (18, 19, 23),
        pair("tau_x tau_y", "s", 2e-5, 1e-3, "delay beyond the phase that it has at the nominal frequency"),
        ("temperature", "side bands"), BOTH,
        "V_j += -tau_j (dV_j/dt + i (w - w0) V_j), w of the reference, w0 nominal",
        ("thermal_pickoff_phase", "pickoff_lag", "drive_delay"),
    ),
    Effect(
        "pickoff_memory", "Dielectric absorption in the pick-off", "pick-off", (32,),
        (
            signed("share", "1", 0.003, 1.0, "slow part over the prompt part"),
            positive("tau", "s", 2.0, 1e5, "time constant", lower=0.01),
        ),
        ("side bands", "time"), BOTH,
        "V += share V_lp, first-order low-pass of time constant tau",
        ("drive_memory", "relaxation"),
    ),
    Effect(
        "pickoff_cross_nonlinearity", "Motion of one axis distorts the reading of the other", "pick-off", None,
        (signed("c", "1/V^2", 0.002, 0.5, "cubic leakage between the readings"),),
        ("amplitudes",), BOTH,
        "V_x += c |V_y|^2 V_y, V_y += c |V_x|^2 V_x",
        ("cubic_cross_stiffness", "pickoff_nonlinearity"),
    ),
    Effect(
        "pickoff_interference", "Reference crosses into the pick-off", "pick-off", (46,),
        (
            signed("v_xc", "V", 1e-3, 1.0, "on x, cosine"),
            signed("v_xs", "V", 1e-3, 1.0, "on x, sine"),
            signed("v_yc", "V", 1e-3, 1.0, "on y, cosine"),
            signed("v_ys", "V", 1e-3, 1.0, "on y, sine"),
        ),
        ("amplitudes", "open drive"), BOTH,
        "V += v, constant in the frame of the phase reference",
        ("constant_force",),
    ),
    Effect(
        "pickoff_quantisation", "Coarse steps of the pick-off converter", "electronics", (24,),
        (positive("lsb", "V", 1e-3, 1.0, "step of the converter"),),
        ("amplitudes",), BOTH,
        "each sample rounded to lsb: no first-order envelope, variance lsb^2/12 per sample, a dead band; the coarser of it and adc_bits",
        ("amplitude_noise",),
    ),
    Effect(
        "channel_skew", "The two pick-offs are sampled at different times", "electronics", (19, 23),
        (signed("tau", "s", 2e-5, 1e-3, "how much later the envelope of y appears; the phase of the carrier is that of the chain"),),
        ("side bands",), BOTH,
        "V_y += -tau dV_y/dt",
        ("pickoff_lag", "multiplexing_skew"),
    ),
    Effect(
        "multiplexing_skew", "The two pick-offs are read in turns: the carrier of y lags, and its phase stays", "electronics", (19, 23),
        (signed("tau", "s", 2e-6, 1e-4, "how much later y appears, carrier and envelope; below zero where it is sampled after x"),),
        ("rate",), BOTH,
        "V_y(t - tau) e^{-i w tau}: P with a phase of y, which turns the response to rate, kappa Omega i w0 tau (V_y, V_x)",
        ("channel_skew", "pickoff_delay"),
    ),
    Effect(
        "amplitude_noise", "Gain of the pick-offs is noisy (reference, jitter)", "electronics", (44, 45),
        (positive("s", "1/sqrt(Hz)", 3e-6, 0.01, "one-sided density of the relative gain, white, common to both"),),
        ("amplitudes",), BOTH,
        "V *= 1 + s n(t), n white up to the control rate: noise that grows with amplitude, in phase with V; a variance effect",
        ("pickoff_quantisation",),
    ),
    Effect(
        "pickoff_gain_flicker", "Gains of the pick-offs flicker (bias voltage, reference)", "electronics", (45,),
        tuple(
            positive(f"g_{axis}", "1/sqrt(Hz)", 3e-5, 0.01, f"one-sided density of the relative gain at 1 Hz, {axis}") for axis in "xy"
        ),
        ("amplitudes",), BOTH,
        "V_j *= 1 + g_j n_j(t), n of density 1/f: what moves by axis is noise of A through its derivative; a variance effect",
        ("amplitude_noise", "drive_gain_flicker", "pickoff_gain_drift"),
    ),
    Effect(
        "pickoff_phase_flicker", "Phases of the pick-offs flicker (amplifier, demodulator's clock)", "electronics", (45,),
        tuple(positive(f"p_{axis}", "rad/sqrt(Hz)", 3e-5, 0.01, f"one-sided density of the phase at 1 Hz, {axis}") for axis in "xy"),
        (), BOTH,
        "V_j *= exp(i p_j n_j(t)), n of density 1/f: what moves by axis is noise of the frequency, rising with f; a variance effect",
        ("pickoff_phase_drift", "reference_spur"),
    ),
    Effect(
        "reference_spur", "Phase of the reference swings besides what its frequency says", "electronics", (46,),
        (
            positive("frequency_hz", "Hz", 20.0, 1000.0, "frequency of the swing", lower=0.1),
            positive("s", "rad", 1e-5, 0.1, "its amplitude"),
        ),
        ("time",), BOTH,
        "V and u are read in a frame that swings by s sin(2 pi frequency t), t the device time: i phi' p beside the slow flow",
        ("mains_pickup",),
    ),
    Effect(
        "clock_drift", "Clock of the device that goes ever faster or slower", "electronics", (48,),
        (signed("e", "1/s", 1e-9, 1e-4, "relative frequency of the clock per second"),),
        ("time",), BOTH,
        "p' += -i omega e t p: all frequencies are told in its own; of rates and damping it is the share e t, below any noise",
        ("frequency_ageing",),
    ),
    Effect(
        "mains_pickup", "Hum of the mains on the pick-offs, about the carrier", "electronics", (46,),
        (
            positive("frequency_hz", "Hz", 50.0, 1000.0, "frequency of the hum", lower=0.1),
            signed("v_x", "V", 1e-4, 1.0, "on x"),
            signed("v_y", "V", 1e-4, 1.0, "on y"),
        ),
        ("time",), BOTH,
        "V_j += v_j cos(2 pi frequency t), t the device time: in phase with the reference, side bands at +-frequency",
        ("external_tone",),
    ),
)  # fmt: skip
