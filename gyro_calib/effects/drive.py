"""Effects between the commanded drive and the force."""

from __future__ import annotations

from ._short import BOTH, pair, positive, signed
from .effect import Effect

__all__ = ["DRIVE"]

DRIVE = (
    Effect(
        "drive_nonlinearity", "Force not proportional to the drive voltage", "drive", (25, 35),
        pair("d_x d_y", "1/V^2", 0.01, 10.0, "relative growth of the force per amplitude squared of the drive; below zero saturates"),
        ("large drive", "amplitudes"), BOTH,
        "u_j += d_j |u_j|^2 u_j; per sample v (1 + (4/3) d v^2)",
        ("drive_sag", "drive_saturation", "nonlinear_damping"),
    ),
    Effect(
        "drive_amplitude_phase", "Phase of the drive that depends on its amplitude", "drive", (18,),
        pair("d_x d_y", "rad/V^2", 0.01, 10.0, "phase lead per amplitude squared of the drive"),
        ("large drive", "amplitudes"), BOTH,
        "u_j += i d_j |u_j|^2 u_j",
        ("duffing", "drive_nonlinearity"),
    ),
    Effect(
        "drive_stiffness", "Stiffness that follows the square of the drive voltage", "drive", (35, 36),
        pair("k_x k_y", "rad/s/V^2", 0.01, 10.0, "frequency per amplitude squared of the axis' own drive in quadrature (in phase thrice)"),
        ("large drive", "amplitudes"), BOTH,
        "p_j' += i k_j (2 |u_j|^2 p_j + u_j^2 p_j*); per sample a stiffness proportional to v_j^2",
        ("duffing", "parametric_pump", "drive_amplitude_phase"),
    ),
    Effect(
        "drive_stiffness_mean", "Stiffness that follows the mean square of the drive voltage", "drive", (35, 36),
        pair("k_x k_y", "rad/s/V^2", 0.01, 10.0, "frequency per amplitude squared of the axis' own drive, at any phase"),
        ("large drive", "amplitudes"), BOTH,
        "p_j' += i k_j |u_j|^2 p_j; per sample a stiffness proportional to the square of the drive's amplitude",
        ("duffing", "drive_stiffness", "drive_amplitude_phase"),
    ),
    Effect(
        "drive_gap", "Force of a drive that grows as its gap closes: gain by the square of the motion", "drive", (5, 33, 35),
        pair("d_x d_y", "1/V^2", 1e-3, 1.0, "relative gain per squared motion of the axis, in pick-off volts"),
        ("amplitudes",), BOTH,
        "u_j += d_j (2 |V_j|^2 u_j + V_j^2 u_j*) / 4; per sample v (1 + d V^2)",
        ("drive_nonlinearity", "driven_pump", "pickoff_nonlinearity"),
    ),
    Effect(
        "drive_gain_flicker", "Gains of the drives flicker (bias voltage, reference, amplifier)", "drive", (45,),
        tuple(positive(f"g_{axis}", "1/sqrt(Hz)", 3e-4, 0.1, f"one-sided density of the relative gain at 1 Hz, {axis}") for axis in "xy"),
        ("time",), BOTH,
        "u_j *= 1 + g_j n_j(t), n of density 1/f: noise of the amplitude in proportion to the damping; a variance effect",
        ("pickoff_gain_flicker", "drive_gain_drift"),
    ),
    Effect(
        "drive_saturation", "Drive amplifier clips", "drive", (25,),
        (positive("level", "V", 0.5, 100.0, "largest carrier voltage of either axis", lower=1e-4),),
        ("large drive",), BOTH,
        "each axis' carrier voltage is held within +-level (describing function of a clipped sine)",
        ("drive_nonlinearity", "drive_sag"),
    ),
    Effect(
        "drive_dead_zone", "Drive does nothing below a voltage", "drive", (26,),
        (positive("level", "V", 0.005, 10.0, "half-width of the dead zone of the carrier voltage"),),
        ("amplitudes",), BOTH,
        "each axis' carrier voltage: 0 for |v| < level, else v less level, sign kept",
        ("drive_nonlinearity", "coulomb_friction", "drive_quantisation"),
    ),
    Effect(
        "drive_sag", "Supply sags under the drive of both axes", "drive", None,
        (signed("d", "1/V^2", 0.01, 10.0, "relative growth of both gains per total amplitude squared"),),
        ("large drive", "amplitudes"), BOTH,
        "u += d (|u_x|^2 + |u_y|^2) u",
        ("drive_nonlinearity", "drive_cross_nonlinearity"),
    ),
    Effect(
        "drive_lag", "Drive lags its command", "drive", (18, 20),
        (positive("tau", "s", 2e-4, 0.05, "delay of the drive's envelope; the phase of the carrier is that of G"),),
        ("side bands",), BOTH,
        "u += -tau du/dt, exactly: u through a first-order low-pass of time constant tau",
        ("pickoff_lag", "spurious_mode"),
    ),
    Effect(
        "drive_delay", "Drive's carrier is late: an amplifier, a cable, a slot", "drive", (18, 19, 23),
        pair("tau_x tau_y", "s", 2e-5, 1e-3, "delay beyond the phase that it has at the nominal frequency"),
        ("temperature", "side bands"), BOTH,
        "u_j += -tau_j (du_j/dt + i (w - w0) u_j), w of the reference, w0 nominal",
        ("thermal_drive_phase", "drive_lag", "pickoff_delay"),
    ),
    Effect(
        "drive_memory", "Dielectric absorption in the drive", "drive", (32,),
        (
            signed("share", "1", 0.01, 1.0, "slow part over the prompt part"),
            positive("tau", "s", 2.0, 1e5, "time constant", lower=0.01),
        ),
        ("side bands", "time"), BOTH,
        "u += share u_lp, first-order low-pass of time constant tau",
        ("relaxation", "pickoff_memory", "drive_lag"),
    ),
    Effect(
        "drive_cross_nonlinearity", "Drive of one axis distorts that of the other", "drive", None,
        (signed("d", "1/V^2", 0.01, 10.0, "cubic leakage between the drives"),),
        ("large drive", "amplitudes"), BOTH,
        "u_x += d |u_y|^2 u_y, u_y += d |u_x|^2 u_x",
        ("drive_sag", "cubic_cross_stiffness"),
    ),
    Effect(
        "drive_quantisation", "Coarse steps of the drive converter", "electronics", (24,),
        (positive("lsb", "V", 2e-4, 1.0, "step of the converter"),),
        ("amplitudes",), BOTH,
        "each sample rounded to lsb: no first-order envelope, variance lsb^2/12 per sample, a dead band; the coarser of it and dac_bits",
        ("drive_dead_zone", "amplitude_noise"),
    ),
)  # fmt: skip
