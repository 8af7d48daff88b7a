"""Effects of the resonator itself: forces that depend on its motion in other ways than linearly and at once."""

from __future__ import annotations

from ._short import BOTH, pair, positive, pump_rates, signed
from .effect import Effect

__all__ = ["DYNAMICS"]

DYNAMICS = (
    Effect(
        "duffing", "Stiffness that grows with amplitude, alike in all directions", "dynamics", (4,),
        (signed("k", "rad/s/V^2", 0.05, 20.0, "frequency shift of a linear wave per amplitude squared"),),
        ("amplitudes",), BOTH,
        "p' += i k (2 |p|^2 p + (p.p) p*) / 3; force -k3 (x^2 + y^2)(x, y)",
        ("duffing_axes", "thermal_frequency_curvature", "frequency_ageing"),
    ),
    Effect(
        "duffing_axes", "Stiffness that grows with amplitude, by electrode axis (gap softening)", "dynamics", (5, 6),
        pair("k_x k_y", "rad/s/V^2", 0.05, 20.0, "frequency shift of a wave on the axis per amplitude squared"),
        ("amplitudes",), BOTH,
        "p_j' += i k_j |p_j|^2 p_j; force -k3j x_j^3",
        ("duffing", "cubic_cross_stiffness", "pickoff_amplitude_phase"),
    ),
    Effect(
        "cubic_cross_stiffness", "Cubic stiffness that couples the axes", "dynamics", (7,),
        (signed("k", "rad/s/V^2", 0.02, 10.0, "coupling rate per amplitude squared"),),
        ("amplitudes",), BOTH,
        "p_x' += i k |p_y|^2 p_y, p_y' += i k |p_x|^2 p_x; force -k3 (y^3, x^3)",
        ("cubic_cross_stiffness_axes", "duffing_axes", "pickoff_cross_nonlinearity"),
    ),
    Effect(
        "cubic_cross_stiffness_axes", "Cubic stiffness that couples the axes, of the potentials x^3 y and x y^3", "dynamics", (7, 33),
        pair("k_x k_y", "rad/s/V^2", 0.02, 10.0, "coupling rate per squared amplitude of the axis that is cubed"),
        ("amplitudes",), BOTH,
        "p_x' += i k_x (2 |p_x|^2 p_y + p_x^2 p_y*), p_y' += i k_x |p_x|^2 p_x, and k_y the other way; force -k3x (3 x^2 y, x^3)",
        ("cubic_cross_stiffness", "duffing_axes"),
    ),
    Effect(
        "circulatory_stiffness", "Cross stiffness that is not symmetric (non-reciprocal)", "dynamics", (3,),
        (signed("k", "rad/s", 0.02, 50.0, "antisymmetric part of the cross stiffness, as a rate of the envelopes"),),
        ("rate",), BOTH,
        "p' += i k J p: a part of A, told from a symmetric one through unequal pick-offs by what a rate does to these",
        ("channel_skew", "multiplexing_skew"),
    ),
    Effect(
        "nonlinear_damping", "Damping that grows with the square of the velocity", "dynamics", (9,),
        (signed("c", "1/s/V^2", 0.01, 5.0, "decay rate per amplitude squared"),),
        ("amplitudes",), BOTH,
        "p' += -c (2 |p|^2 p + (p.p) p*) / 3; force -c3 |v|^2 v",
        ("quadratic_damping", "nonlinear_damping_axes", "drive_nonlinearity", "pickoff_nonlinearity"),
    ),
    Effect(
        "nonlinear_damping_axes", "Damping that grows with the square of the velocity, by axis", "dynamics", (9,),
        (
            *pair("c_x c_y", "1/s/V^2", 0.01, 5.0, "decay rate of a wave on the axis per amplitude squared"),
            signed("c_xy", "1/s/V^2", 0.01, 5.0, "of axes that are turned: what x does to y per amplitude squared"),
            signed("c_yx", "1/s/V^2", 0.01, 5.0, "of axes that are turned: what y does to x per amplitude squared"),
            signed("c_xxyy", "1/s/V^2", 0.01, 5.0, "of axes that are turned: what each does to the other one's own motion, likewise"),
        ),
        ("amplitudes",), BOTH,
        "p_j' += -c_j |p_j|^2 p_j - c_kj |p_k|^2 p_k - c_jk (2 |p_j|^2 p_k + p_j^2 p_k*) - c_xxyy (2 |p_k|^2 p_j + p_k^2 p_j*)/3, "
        "k the other axis; force -d/dv of c3x v_x^4/4 + c3y v_y^4/4 + c3xy v_x^3 v_y + c3yx v_x v_y^3 + c3xxyy v_x^2 v_y^2/2",
        ("nonlinear_damping", "pickoff_nonlinearity", "drive_nonlinearity"),
    ),
    Effect(
        "quadratic_damping", "Drag proportional to the square of the velocity (fluid)", "dynamics", None,
        (positive("c", "1/s/V", 0.01, 5.0, "decay rate per amplitude"),),
        ("amplitudes",), BOTH,
        "p' += -c (3 |p| p + (p.p) p*/|p|) / 4: -c |p| p of a linear wave, its quadrature damped half as much; force -c2 |v| v",
        ("nonlinear_damping", "coulomb_friction"),
    ),
    Effect(
        "coulomb_friction", "Dry friction: a force that does not depend on the speed", "dynamics", None,
        (positive("c", "V/s", 0.005, 1.0, "amplitude lost per second"),),
        ("amplitudes",), BOTH,
        "p' += -c p / |p| of a linear wave, its quadrature q (|p| = a) damped ln(4 a/q) - 1 times as much; force -c0 v / |v|",
        ("quadratic_damping", "drive_dead_zone", "coulomb_friction_axes"),
    ),
    Effect(
        "coulomb_friction_axes", "Dry friction of each axis by itself", "dynamics", None,
        tuple(positive(f"c_{a}", "V/s", 0.005, 1.0, f"amplitude of a wave on {a} lost per second") for a in "xy"),
        ("amplitudes",), BOTH,
        "p_j' += -c_j p_j / |p_j|; force -c0_j sign(v_j)",
        ("coulomb_friction", "drive_dead_zone", "nonlinear_damping_axes"),
    ),
    Effect(
        "spurious_mode", "Another mode (or pair of modes) near the resonance, driven and read along with it", "dynamics", (39,),
        (
            signed("separation_hz", "Hz", 3.0, 2000.0, "its frequency above the mean natural frequency, which it follows with temperature"),
            positive("half_width_hz", "Hz", 2.0, 500.0, "its half-width", lower=0.01),
            *(signed(f"gain_{a}{b}", "1/s", 0.05, 50.0, f"what it adds to the {a} pick-off of the {b} drive") for a in "xy" for b in "xy"),
        ),
        ("side bands", "open drive"), BOTH,
        "V_j -= i sum_k gain_jk q_k, q_k' = (2 pi i separation - i dw - 2 pi half_width) q_k + u_k, dw: reference above the mean frequency",
        ("pickoff_memory", "drive_memory", "drive_lag"),
    ),
    Effect(
        "relaxation", "Stiffness with a memory of the amplitude (anelastic)", "dynamics", None,
        (
            signed("c", "rad/s", 0.02, 10.0, "relaxing part of the frequency"),
            positive("tau", "s", 3.0, 1e5, "time constant", lower=0.01),
        ),
        ("side bands",), BOTH,
        "p' += i c (p_lp - p), p_lp the displacement's envelope through a first-order low-pass of time constant tau",
        ("drive_memory", "pickoff_memory", "duffing"),
    ),
    Effect(
        "parametric_pump", "Stiffness modulated at twice the reference", "dynamics", (35, 36),
        (
            signed("h_c", "1/s", 0.02, 10.0, "growth of what is in phase with the reference, decay of the other quadrature"),
            signed("h_s", "1/s", 0.02, 10.0, "exchange between the quadratures"),
        ),
        ("open drive", "azimuth"), BOTH,
        "p' += (h_c + i h_s) p*",
        ("constant_force", "thermal_damping", "parametric_pump_axes"),
    ),
    Effect(
        "parametric_pump_axes", "Stiffness modulated at twice the reference, by axis", "dynamics", (35, 36),
        pump_rates("1/s", 0.02, 10.0),
        ("open drive", "azimuth"), BOTH,
        "p_j' += (h_jc + i h_js) p_j*",
        ("parametric_pump", "driven_pump"),
    ),
    Effect(
        "driven_pump", "Stiffness modulated at twice the reference by the command of the amplitude loop", "dynamics", (36,),
        pump_rates("1/s/V", 0.05, 100.0),
        ("amplitudes",), BOTH,
        "p_j' += (h_jc + i h_js) U p_j*, U = Re[(i p)^H u] / |p| the drive along the velocity; none while the loops are off",
        ("parametric_pump_axes", "quadratic_damping"),
    ),
    Effect(
        "constant_force", "A force in step with the reference that no drive asked for", "dynamics", (22,),
        (
            signed("f_xc", "V", 2e-4, 5.0, "on x, cosine, in volts of drive"),
            signed("f_xs", "V", 2e-4, 5.0, "on x, sine, in volts of drive"),
            signed("f_yc", "V", 2e-4, 5.0, "on y, cosine, in volts of drive"),
            signed("f_ys", "V", 2e-4, 5.0, "on y, sine, in volts of drive"),
        ),
        ("amplitudes", "open drive"), BOTH,
        "u += f, constant in the frame of the phase reference",
        ("pickoff_interference", "coulomb_friction"),
    ),
)  # fmt: skip
