"""The carrier kernel: every converter sample of the two modes, drives, pick-offs and loops, recorded rows out.

Linear motion is exact (:mod:`.propagator`); nonlinear forces and noise are kicks between exact steps (Strang splitting, symmetric, so they
add no numerical damping). Demodulation is by the phase reference at each sample, filtered by the boxcar cascade of :mod:`.filters`.
"""

from __future__ import annotations

import math

import numpy as np

from ..device.averaging import instant_force
from ..device.electronics import SLOTS
from ..jit import kernel
from .control import control_step
from .control_layout import S_BODY, S_DRIVE, S_OMEGA, S_PHASE, S_SLOT, middle_motion
from .effect_forces import pump_stiffness
from .effect_kernels import always_on_forces, effect_samples, stray_feeds
from .effect_layout import E_GAIN, E_SPUR, E_SPUR_OMEGA, M_TIME
from .effect_memory import drive_phasors, pick_phasors
from .multiplex import READ_X, READ_Y, hold_columns, slot_envelope, slot_gains
from .propagator import exact_propagator, stiffness_step

__all__ = [
    "FLAG_CONVERTERS",
    "FLAG_EFFECTS",
    "FLAG_MULTIPLEXED",
    "FLAG_NONLINEAR",
    "FLAG_PICKOFF_CUBIC",
    "FLAG_PICKOFF_GAP",
    "FLAG_RAW",
    "FLAG_STRAY",
    "FLAG_TWICE",
    "RAW_CHANNELS",
    "carrier_rows",
    "emit_row",
]

FLAG_NONLINEAR, FLAG_CONVERTERS, FLAG_PICKOFF_CUBIC, FLAG_PICKOFF_GAP, FLAG_RAW = 1, 2, 4, 8, 16
FLAG_MULTIPLEXED, FLAG_TWICE, FLAG_STRAY, FLAG_EFFECTS = 32, 64, 128, 256
#: x pick-off, y pick-off, x drive as the converter holds it, y drive [V], phase reference [rad]
RAW_CHANNELS = 5


@kernel
def _converter(value, full_scale, lsb):  # type: ignore[no-untyped-def]
    """Quantise to ``lsb`` (0: ideal) and clip at the full scale."""
    if lsb > 0.0:
        value = lsb * math.floor(value / lsb + 0.5)
    return min(max(value, -full_scale), full_scale)


@kernel
def emit_row(steps, row_w, acc, out):  # type: ignore[no-untyped-def]
    """Pass the control steps (controls, 9) of one row through the row filter: write the row to ``out``, carry on ``acc`` (2, 9).

    ``row_w`` (2, 3, controls): weights of the pick-offs, which have passed the converter filter, and of the rest, which have it folded in.
    """
    # three columns at a time, so that the nine sums stay in registers
    for q in range(0, 9, 3):
        a0, a1, a2 = acc[0, q], acc[0, q + 1], acc[0, q + 2]
        b0, b1, b2 = acc[1, q], acc[1, q + 1], acc[1, q + 2]
        c0 = c1 = c2 = 0.0
        first, rest = row_w[0 if q < 4 else 1], row_w[0 if q < 2 else 1]
        for j in range(steps.shape[0]):
            s0, s1, s2 = steps[j, q], steps[j, q + 1], steps[j, q + 2]
            a0, a1, a2 = a0 + first[0, j] * s0, a1 + rest[0, j] * s1, a2 + rest[0, j] * s2
            b0, b1, b2 = b0 + first[1, j] * s0, b1 + rest[1, j] * s1, b2 + rest[1, j] * s2
            c0, c1, c2 = c0 + first[2, j] * s0, c1 + rest[2, j] * s1, c2 + rest[2, j] * s2
        out[q], out[q + 1], out[q + 2] = a0, a1, a2
        acc[0, q], acc[0, q + 1], acc[0, q + 2] = b0, b1, b2
        acc[1, q], acc[1, q + 1], acc[1, q + 2] = c0, c1, c2


@kernel
def _write_raw(volts, phase, advance, axr, axi, ayr, ayi, settling, line, first):  # type: ignore[no-untyped-def]
    """Write the raw samples of one control step: the pick-offs from their products with the reference, the drives as they are held."""
    for j in range(volts.shape[0]):
        angle = phase + advance * j
        c, s = math.cos(angle), math.sin(angle)
        at = first + RAW_CHANNELS * j
        line[at] = 0.5 * (volts[j, 0] * c - volts[j, 1] * s)
        line[at + 1] = 0.5 * (volts[j, 2] * c - volts[j, 3] * s)
        line[at + 2] = axr * c - axi * s if j >= settling else 0.0
        line[at + 3] = ayr * c - ayi * s if j >= settling else 0.0
        line[at + 4] = angle


@kernel
def carrier_rows(  # type: ignore[no-untyped-def]
    z, loop, param, adc_acc, row_acc, adc_w, row_w, physics, drive, stray, pick, feed, body, nonlinear, converters, const, flags, noise,
    out, effect, memory, effect_rows, gain_noise,
):  # fmt: skip
    """Simulate ``out.shape[0]`` rows, in place.

    Parameters
    ----------
    z : ndarray, shape (MOTION,)
        Motion (x, y, x'/w, y'/w) [m], and the stiffness of the last row.
    loop, param : ndarray
        State and parameters of :func:`.control.control_step`.
    adc_acc : ndarray, shape (2, 4)
        Accumulators of the demodulated pick-offs: of the period under way and of the one after it. Multiplexed: the first keeps the
        readings.
    row_acc : ndarray, shape (2, 9)
        Accumulators of the row under way and of the one after it.
    adc_w, row_w : ndarray, shape (3, samples) and (2, 3, controls)
        Polyphase weights; ``row_w`` as in :func:`emit_row`.
    physics : ndarray, shape (rows, 8)
        k11, k12, k22 [1/s^2], c11, c12, c21, c22 [1/s] (damping plus Coriolis), force-noise kick [m/s per sample, over w] of each row.
    drive, pick, feed : ndarray, shape (rows or 1, 8)
        B [m/s^2/V], P [V/m], E: re, im of xx, xy, yx, yy. Drive and pick per row.
    stray : ndarray, shape (rows, 4), or (0, 4) without FLAG_STRAY
        Drive that reaches the electrodes besides the command [V]: re, im of x, y.
    body : float
        Force per mass and volt of the body excitation [m/s^2/V].
    nonlinear : ndarray, shape (8,)
        As :func:`gyro_calib.device.averaging.instant_force` takes them [1/(m^2 s^2)], the sixth [1/(m^2 s)].
    converters : ndarray, shape (8,)
        ADC full scale, ADC step, DAC full scale, DAC step [V], pick-off cubic of x [1/V^2], one over the gap of x and y in pick-off volts
        [1/V], pick-off cubic of y [1/V^2]. The step of the DAC is the effect kernels'.
    const : ndarray, shape (5,)
        Sample time [s], nominal w [rad/s], pick-off noise [V per sample], samples in which a multiplexed chain settles, factor of the drive
        per metre of motion with FLAG_TWICE [1/m].
    flags : int
        Which of the rarer branches are on.
    noise : ndarray, shape (4 samples,), float32
        Standard normals: force x, y, pick-off x, y of each sample.
    out : ndarray, shape (rows, 9), or (rows, 9 + RAW_CHANNELS controls samples) with FLAG_RAW
        x_pick_c, x_pick_s, y_pick_c, y_pick_s, x_drive_c, x_drive_s, y_drive_c, y_drive_s, reference omega [rad/s]; then the raw samples
        made while the row was under way (the row itself is centred earlier, by the delay of its filter).
    effect, memory : ndarray, shape (N_EFFECT,) and (N_MEMORY,)
        Numbers and state of the effects (:mod:`.effect_layout`), with FLAG_EFFECTS.
    effect_rows : ndarray, shape (rows, N_ROW), or (0, N_ROW) without FLAG_EFFECTS
        What of the effects changes from row to row.
    gain_noise : ndarray, shape (rows controls,), or (0,)
        Standard normals of the pick-offs' gain, one per control period; empty: a steady gain.
    """
    rows = out.shape[0]
    samples = adc_w.shape[1]
    controls = row_w.shape[2]
    dt, w, pick_noise = const[0], const[1], const[2]
    phi = np.zeros((4, 4))
    gamma = np.zeros((4, 2))
    steps = np.empty((controls, 9))
    volts = np.empty((samples, 4))
    n00, n01, n02, n03 = adc_acc[0, 0], adc_acc[0, 1], adc_acc[0, 2], adc_acc[0, 3]
    n10, n11, n12, n13 = adc_acc[1, 0], adc_acc[1, 1], adc_acc[1, 2], adc_acc[1, 3]
    nonlinear_on, converters_on, cubic_on = flags & FLAG_NONLINEAR != 0, flags & FLAG_CONVERTERS != 0, flags & FLAG_PICKOFF_CUBIC != 0
    gap_on, raw_on = flags & FLAG_PICKOFF_GAP != 0, flags & FLAG_RAW != 0
    multiplexed, twice_on, stray_on = flags & FLAG_MULTIPLEXED != 0, flags & FLAG_TWICE != 0, flags & FLAG_STRAY != 0
    effects_on = flags & FLAG_EFFECTS != 0
    settling = int(const[3]) if multiplexed else 0
    on_share, due = (samples - settling) / samples, True
    half_kick = -0.5 * dt / w
    n = 0
    x, y, vx, vy = z[0], z[1], z[2], z[3]
    phase = loop[S_PHASE]
    for row in range(rows):
        p = physics[row]
        d11, d12, d22 = stiffness_step(z, p, w)
        x, y = x - (d11 * x + d12 * y), y - (d12 * x + d22 * y)
        vx, vy = vx + (d11 * vx + d12 * vy), vy + (d12 * vx + d22 * vy)
        exact_propagator(p[0], p[1], p[2], p[3], p[4], p[5], p[6], w, dt, phi, gamma)
        f00, f01, f02, f03 = phi[0, 0], phi[0, 1], phi[0, 2], phi[0, 3]
        f10, f11, f12, f13 = phi[1, 0], phi[1, 1], phi[1, 2], phi[1, 3]
        f20, f21, f22, f23 = phi[2, 0], phi[2, 1], phi[2, 2], phi[2, 3]
        f30, f31, f32, f33 = phi[3, 0], phi[3, 1], phi[3, 2], phi[3, 3]
        g00, g01, g10, g11 = gamma[0, 0], gamma[0, 1], gamma[1, 0], gamma[1, 1]
        g20, g21, g30, g31 = gamma[2, 0], gamma[2, 1], gamma[3, 0], gamma[3, 1]
        b, pk, kick = drive[row], pick[row], p[7]
        for step in range(controls):
            omega = loop[S_OMEGA]
            uxc, uxs, uyc, uys = loop[S_DRIVE], loop[S_DRIVE + 1], loop[S_DRIVE + 2], loop[S_DRIVE + 3]
            # firmware advances the drive by half a hold, so the hold's delay does not turn the force
            half = 0.5 * omega * dt
            ca, sa = math.cos(half), math.sin(half)
            gx, gy = slot_gains(loop) if multiplexed else (1.0, 1.0)
            gx, gy = gx / on_share, gy / on_share
            if effects_on:
                qxc, qxs, qyc, qys = drive_phasors(memory, effect, omega, gx, gy, uxc, uxs, uyc, uys)
            else:
                qxc, qxs, qyc, qys = gx * uxc, gx * uxs, gy * uyc, gy * uys
            axr, axi = qxc * ca - qxs * sa, qxc * sa + qxs * ca
            ayr, ayi = qyc * ca - qys * sa, qyc * sa + qys * ca
            fxr = b[0] * axr - b[1] * axi + b[2] * ayr - b[3] * ayi
            fxi = b[0] * axi + b[1] * axr + b[2] * ayi + b[3] * ayr
            fyr = b[4] * axr - b[5] * axi + b[6] * ayr - b[7] * ayi
            fyi = b[4] * axi + b[5] * axr + b[6] * ayi + b[7] * ayr
            # what acts whether the drives are on or not
            wxr = wyr = body * loop[S_BODY] * ca
            wxi = wyi = body * loop[S_BODY] * sa
            if stray_on:
                qxr, qxi, qyr, qyi = stray[row, 0], stray[row, 1], stray[row, 2], stray[row, 3]
                wxr += b[0] * qxr - b[1] * qxi + b[2] * qyr - b[3] * qyi
                wxi += b[0] * qxi + b[1] * qxr + b[2] * qyi + b[3] * qyr
                wyr += b[4] * qxr - b[5] * qxi + b[6] * qyr - b[7] * qyi
                wyi += b[4] * qxi + b[5] * qxr + b[6] * qyi + b[7] * qyr
            factor = 1.0
            if twice_on:
                factor = const[4] * middle_motion(loop, math.sqrt((x * x + y * y) + (vx * vx + vy * vy)))
                fxr, fxi, fyr, fyi = factor * fxr, factor * fxi, factor * fyr, factor * fyi
            fxr, fxi, fyr, fyi = fxr + wxr, fxi + wxi, fyr + wyr, fyi + wyi
            exr = feed[0] * uxc - feed[1] * uxs + feed[2] * uyc - feed[3] * uys
            exi = feed[0] * uxs + feed[1] * uxc + feed[2] * uys + feed[3] * uyc
            eyr = feed[4] * uxc - feed[5] * uxs + feed[6] * uyc - feed[7] * uys
            eyi = feed[4] * uxs + feed[5] * uxc + feed[6] * uys + feed[7] * uyc
            turn_c, turn_s = math.cos(omega * dt), math.sin(omega * dt)
            # demodulator and modulator share the reference, and what swings it
            read = phase + effect[E_SPUR] * math.sin(effect[E_SPUR_OMEGA] * memory[M_TIME]) if effects_on else phase
            c, s = math.cos(read), math.sin(read)
            if effects_on:
                z[0], z[1], z[2], z[3] = x, y, vx, vy
                always = always_on_forces(z, memory, effect, b, c, s, ca, sa, wxr, wxi, wyr, wyi)
                feeds = stray_feeds(memory, effect, effect_rows[row], uxc, uxs, uyc, uys, exr, exi, eyr, eyi)
                pump = pump_stiffness(effect, x, y, vx, vy, c, s, uxc, uxs, uyc, uys)
                gain = 1.0 + effect[E_GAIN] * gain_noise[row * controls + step] if gain_noise.size > 0 else 1.0
                effect_samples(
                    z, volts, memory, effect, effect_rows[row], phi, gamma, b, pk, (axr, axi, ayr, ayi), always, feeds, pump,
                    read, omega, dt, w, settling, factor, gain, kick, pick_noise, nonlinear, converters, noise, n,
                )  # fmt: skip
                x, y, vx, vy = z[0], z[1], z[2], z[3]
                n += 4 * samples
            for j in range(0 if effects_on else samples):
                # Re[P Z e^{i phi}] with Im[Z e^{i phi}] = -velocity / w
                voltx = (pk[0] * x + pk[1] * vx) + (pk[2] * y + pk[3] * vy)
                volty = (pk[4] * x + pk[5] * vx) + (pk[6] * y + pk[7] * vy)
                if gap_on:  # C ~ 1/(d - z) less its value at rest
                    voltx /= 1.0 - voltx * converters[5]
                    volty /= 1.0 - volty * converters[6]
                voltx += exr * c - exi * s + pick_noise * noise[n + 2]
                volty += eyr * c - eyi * s + pick_noise * noise[n + 3]
                if cubic_on:
                    voltx += converters[4] * voltx * voltx * voltx
                    volty += converters[7] * volty * volty * volty
                if converters_on:
                    voltx = _converter(voltx, converters[0], converters[1])
                    volty = _converter(volty, converters[0], converters[1])
                volts[j, 0], volts[j, 1], volts[j, 2], volts[j, 3] = 2.0 * voltx * c, -2.0 * voltx * s, 2.0 * volty * c, -2.0 * volty * s
                if j < settling:
                    forcex, forcey = wxr * c - wxi * s, wyr * c - wyi * s
                else:
                    forcex, forcey = fxr * c - fxi * s, fyr * c - fyi * s
                if nonlinear_on:
                    kx, ky = instant_force(x, y, vx * w, vy * w, nonlinear)
                    vx += half_kick * kx
                    vy += half_kick * ky
                x1 = ((f00 * x + f01 * y) + (f02 * vx + f03 * vy)) + (g00 * forcex + g01 * forcey)
                y1 = ((f10 * x + f11 * y) + (f12 * vx + f13 * vy)) + (g10 * forcex + g11 * forcey)
                vx1 = ((f20 * x + f21 * y) + (f22 * vx + f23 * vy)) + (g20 * forcex + g21 * forcey + kick * noise[n])
                vy1 = ((f30 * x + f31 * y) + (f32 * vx + f33 * vy)) + (g30 * forcex + g31 * forcey + kick * noise[n + 1])
                x, y, vx, vy = x1, y1, vx1, vy1
                if nonlinear_on:
                    kx, ky = instant_force(x, y, vx * w, vy * w, nonlinear)
                    vx += half_kick * kx
                    vy += half_kick * ky
                c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
                n += 4
            if raw_on:
                _write_raw(volts, read, omega * dt, axr, axi, ayr, ayi, settling, out[row], 9 + RAW_CHANNELS * samples * step)
            if multiplexed:
                slot = int(loop[S_SLOT])
                if slot == READ_X:
                    n00, n01 = slot_envelope(volts, 0, read, omega * dt, settling)
                elif slot == READ_Y:
                    n02, n03 = slot_envelope(volts, 2, read, omega * dt, settling)
                due = slot == READ_Y
            phase = (phase + omega * dt * samples) % (2.0 * math.pi)
            xc, xs, yc, ys = n00, n01, n02, n03
            if not multiplexed:
                n00, n01, n02, n03 = n10, n11, n12, n13
                n10 = n11 = n12 = n13 = 0.0
            for j in range(0 if multiplexed else samples):
                h0, h1, h2 = adc_w[0, j], adc_w[1, j], adc_w[2, j]
                v0, v1, v2, v3 = volts[j, 0], volts[j, 1], volts[j, 2], volts[j, 3]
                xc, xs, yc, ys = xc + h0 * v0, xs + h0 * v1, yc + h0 * v2, ys + h0 * v3
                n00, n01, n02, n03 = n00 + h1 * v0, n01 + h1 * v1, n02 + h1 * v2, n03 + h1 * v3
                n10, n11, n12, n13 = n10 + h2 * v0, n11 + h2 * v1, n12 + h2 * v2, n13 + h2 * v3
            if effects_on:
                xc, xs, yc, ys = pick_phasors(memory, effect, omega, xc, xs, yc, ys)
            line = steps[step]
            line[0], line[1], line[2], line[3] = xc, xs, yc, ys
            line[4], line[5], line[6], line[7], line[8] = uxc, uxs, uyc, uys, omega
            if multiplexed:
                hold_columns(loop, 1.5 - 0.5 * settling / samples, line)
                loop[S_SLOT] = (loop[S_SLOT] + 1.0) % SLOTS
            if due:
                control_step(loop, param, xc, xs, yc, ys)
        emit_row(steps, row_w, row_acc, out[row])
    z[0], z[1], z[2], z[3] = x, y, vx, vy
    loop[S_PHASE] = phase
    adc_acc[0, 0], adc_acc[0, 1], adc_acc[0, 2], adc_acc[0, 3] = n00, n01, n02, n03
    adc_acc[1, 0], adc_acc[1, 1], adc_acc[1, 2], adc_acc[1, 3] = n10, n11, n12, n13
