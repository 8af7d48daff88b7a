"""The samples of one control period of a device with effects: the same motion as :mod:`.carrier`, with everything that bends it.

Kept apart from the plain samples, so that a device without effects runs as fast as if there were none.
"""

from __future__ import annotations

import math

from ..device.averaging import instant_force
from ..jit import kernel
from .effect_forces import bends_drive, drive_stage, opposes_motion, velocity_force
from .effect_layout import (
    E_CONSTANT,
    E_CURL,
    E_GAP_X,
    E_GAP_Y,
    E_HOLD,
    E_HUM_OMEGA,
    E_HUM_X,
    E_HUM_Y,
    E_MEAN_X,
    E_MEAN_Y,
    E_MODE_HALF,
    E_MODE_XX,
    E_MODE_XY,
    E_MODE_YX,
    E_MODE_YY,
    E_PERIOD,
    E_READ_CROSS,
    E_READ_X,
    E_READ_Y,
    E_RELAX,
    E_SOFT_X,
    E_SOFT_Y,
    E_STRAY,
    E_TONE_OMEGA,
    E_TONE_PHASE,
    E_TONE_X,
    E_TONE_Y,
    M_MODE,
    M_TIME,
    R_FEED,
    R_MODE_OMEGA,
)
from .effect_memory import relaxing_force

__all__ = ["always_on_forces", "effect_samples", "stray_feeds"]


@kernel
def always_on_forces(z, memory, effect, b, c, s, ca, sa, wxr, wxi, wyr, wyi):  # type: ignore[no-untyped-def]
    """Force phasors that act whatever the drives do, with the constant force and the relaxing stiffness added [m/s^2].

    ``c, s``: the reference at the start of the period; ``ca, sa``: half a sample of it, by which a held force must be ahead.
    """
    hold = effect[E_HOLD]
    rxc = rxs = ryc = rys = 0.0
    if effect[E_RELAX] != 0.0:
        rxc, rxs, ryc, rys = relaxing_force(memory, effect, z[0], z[1], z[2], z[3], c, s)
    uxc, uxs, uyc, uys = effect[E_CONSTANT], effect[E_CONSTANT + 1], effect[E_CONSTANT + 2], effect[E_CONSTANT + 3]
    fxc = rxc / hold + b[0] * uxc - b[1] * uxs + b[2] * uyc - b[3] * uys
    fxs = rxs / hold + b[0] * uxs + b[1] * uxc + b[2] * uys + b[3] * uyc
    fyc = ryc / hold + b[4] * uxc - b[5] * uxs + b[6] * uyc - b[7] * uys
    fys = rys / hold + b[4] * uxs + b[5] * uxc + b[6] * uys + b[7] * uyc
    return wxr + fxc * ca - fxs * sa, wxi + fxc * sa + fxs * ca, wyr + fyc * ca - fys * sa, wyi + fyc * sa + fys * ca


@kernel
def stray_feeds(memory, effect, row, uxc, uxs, uyc, uys, exr, exi, eyr, eyi):  # type: ignore[no-untyped-def]
    """Voltage phasors that reach the pick-offs besides the motion: feedthrough that moved, interference, hum [V]."""
    hum = math.cos(effect[E_HUM_OMEGA] * (memory[M_TIME] + 0.5 * effect[E_PERIOD]))
    exr = exr + effect[E_STRAY] + effect[E_HUM_X] * hum
    exi = exi + effect[E_STRAY + 1]
    eyr = eyr + effect[E_STRAY + 2] + effect[E_HUM_Y] * hum
    eyi = eyi + effect[E_STRAY + 3]
    xxr, xxi, xyr, xyi = row[R_FEED], row[R_FEED + 1], row[R_FEED + 2], row[R_FEED + 3]
    yxr, yxi, yyr, yyi = row[R_FEED + 4], row[R_FEED + 5], row[R_FEED + 6], row[R_FEED + 7]
    exr, exi = exr + xxr * uxc - xxi * uxs + xyr * uyc - xyi * uys, exi + xxr * uxs + xxi * uxc + xyr * uys + xyi * uyc
    eyr, eyi = eyr + yxr * uxc - yxi * uxs + yyr * uyc - yyi * uys, eyi + yxr * uxs + yxi * uxc + yyr * uys + yyi * uyc
    return exr, exi, eyr, eyi


@kernel
def _convert(value, full_scale, lsb):  # type: ignore[no-untyped-def]
    if lsb > 0.0:
        value = lsb * math.floor(value / lsb + 0.5)
    return min(max(value, -full_scale), full_scale)


@kernel
def effect_samples(  # type: ignore[no-untyped-def]
    z, volts, memory, effect, row, phi, gamma, b, pk, drives, always, feeds, pump, phase, omega, dt, w, settling, factor, gain, kick,
    pick_noise, nonlinear, converters, noise, n,
):  # fmt: skip
    """Advance one control period, in place.

    Parameters
    ----------
    z : ndarray, shape (4,)
        Motion (x, y, x'/w, y'/w) [m].
    volts : ndarray, shape (samples, 4)
        Filled with the products of the pick-offs with the reference [V].
    memory, effect, row : ndarray
        As :mod:`.effect_layout` has them.
    phi, gamma : ndarray, shape (4, 4) and (4, 2)
        Propagator over a sample.
    b, pk : ndarray, shape (8,)
        B and P: re, im of xx, xy, yx, yy.
    drives, always, feeds : tuple of 4 float
        Phasors (re, im of x, y) of the drive voltages [V], of the forces that are always on [m/s^2], of what feeds through [V].
    pump : tuple of 4 float
        Stiffness at twice the reference: cos and sin of x, of y [1/s^2].
    phase, omega, dt, w : float
        Reference at the first sample [rad], its frequency [rad/s], sample time [s], nominal angular frequency [rad/s].
    settling : int
        Samples at the start during which a multiplexed drive is off.
    factor : float
        Force over that of the drive gains.
    gain : float
        Gain of the pick-offs in this period.
    kick, pick_noise : float
        Scale of the force noise [m/s over w] and of the pick-off noise [V] per sample.
    nonlinear, converters, noise
        As in :func:`.carrier.carrier_rows`.
    n : int
        First of the normals of this period.
    """
    x, y, vx, vy = z[0], z[1], z[2], z[3]
    axr, axi, ayr, ayi = drives
    wxr, wxi, wyr, wyi = always
    exr, exi, eyr, eyi = feeds
    c, s = math.cos(phase), math.sin(phase)
    turn_c, turn_s = math.cos(omega * dt), math.sin(omega * dt)
    tone = effect[E_TONE_OMEGA] * (memory[M_TIME] + 0.5 * dt) + effect[E_TONE_PHASE]
    tone_c, tone_s = math.cos(tone), math.sin(tone)
    step_c, step_s = math.cos(effect[E_TONE_OMEGA] * dt), math.sin(effect[E_TONE_OMEGA] * dt)
    mode1, mode2 = complex(memory[M_MODE], memory[M_MODE + 1]), complex(memory[M_MODE + 2], memory[M_MODE + 3])
    mode_rate = complex(-effect[E_MODE_HALF], row[R_MODE_OMEGA])
    mode_turn = complex(math.cos(row[R_MODE_OMEGA] * dt), math.sin(row[R_MODE_OMEGA] * dt)) * math.exp(-effect[E_MODE_HALF] * dt)
    mode_push = 2.0 / effect[E_HOLD] * (mode_turn - 1.0) / mode_rate
    # in registers, not in arrays that the loop might be writing to
    f00, f01, f02, f03, f10, f11, f12, f13 = phi[0, 0], phi[0, 1], phi[0, 2], phi[0, 3], phi[1, 0], phi[1, 1], phi[1, 2], phi[1, 3]
    f20, f21, f22, f23, f30, f31, f32, f33 = phi[2, 0], phi[2, 1], phi[2, 2], phi[2, 3], phi[3, 0], phi[3, 1], phi[3, 2], phi[3, 3]
    g00, g01, g10, g11 = gamma[0, 0], gamma[0, 1], gamma[1, 0], gamma[1, 1]
    g20, g21, g30, g31 = gamma[2, 0], gamma[2, 1], gamma[3, 0], gamma[3, 1]
    b0, b1, b2, b3, b4, b5, b6, b7 = b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]
    p0, p1, p2, p3, p4, p5, p6, p7 = pk[0], pk[1], pk[2], pk[3], pk[4], pk[5], pk[6], pk[7]
    mode_xx, mode_xy, mode_yx, mode_yy = effect[E_MODE_XX], effect[E_MODE_XY], effect[E_MODE_YX], effect[E_MODE_YY]
    read_x, read_y, read_cross = effect[E_READ_X], effect[E_READ_Y], effect[E_READ_CROSS]
    soft_x, soft_y, gap_x, gap_y = effect[E_SOFT_X], effect[E_SOFT_Y], effect[E_GAP_X], effect[E_GAP_Y]
    mean_x, mean_y, curl = effect[E_MEAN_X], effect[E_MEAN_Y], effect[E_CURL]
    # what is held over a sample stands for the phase in its middle, the motion that it meets is that of its start
    half_c, half_s = math.cos(0.5 * omega * dt), math.sin(0.5 * omega * dt)
    pump_xc, pump_xs, pump_yc, pump_ys = pump
    tone_x, tone_y = effect[E_TONE_X], effect[E_TONE_Y]
    full, lsb, cubic_x, cubic_y = converters[0], converters[1], converters[4], converters[7]
    per_gap_x, per_gap_y = converters[5], converters[6]
    bent, dragged, curved = bends_drive(effect), opposes_motion(effect), nonlinear.any()
    mode_on = mode_xx != 0.0 or mode_xy != 0.0 or mode_yx != 0.0 or mode_yy != 0.0
    turned = read_x != 0.0 or read_y != 0.0
    kick_dt = dt / w
    for j in range(volts.shape[0]):
        readx, ready = (p0 * x + p1 * vx) + (p2 * y + p3 * vy), (p4 * x + p5 * vx) + (p6 * y + p7 * vy)
        readx /= 1.0 - readx * per_gap_x
        ready /= 1.0 - ready * per_gap_y
        readx += mode_xx * mode1.imag + mode_xy * mode2.imag + exr * c - exi * s + pick_noise * noise[n + 2]
        ready += mode_yx * mode1.imag + mode_yy * mode2.imag + eyr * c - eyi * s + pick_noise * noise[n + 3]
        if turned:  # by what the pick-offs were a quarter of a cycle ago
            latex = (p1 * x - p0 * vx) + (p3 * y - p2 * vy) - mode_xx * mode1.real - mode_xy * mode2.real + exr * s + exi * c
            latey = (p5 * x - p4 * vx) + (p7 * y - p6 * vy) - mode_yx * mode1.real - mode_yy * mode2.real + eyr * s + eyi * c
            readx -= read_x * (readx * readx + latex * latex) * latex
            ready -= read_y * (ready * ready + latey * latey) * latey
        cubex, cubey = readx * readx * readx, ready * ready * ready
        readx += cubic_x * cubex + read_cross * cubey
        ready += cubic_y * cubey + read_cross * cubex
        readx, ready = _convert(gain * readx, full, lsb), _convert(gain * ready, full, lsb)
        volts[j, 0], volts[j, 1], volts[j, 2], volts[j, 3] = 2.0 * readx * c, -2.0 * readx * s, 2.0 * ready * c, -2.0 * ready * s
        forcex, forcey = wxr * c - wxi * s, wyr * c - wyi * s
        metx = mety = powerx = powery = 0.0
        if mode_on:
            mode1, mode2 = mode1 * mode_turn, mode2 * mode_turn
        if j >= settling:
            nowx, nowy = axr * c - axi * s, ayr * c - ayi * s
            agox, agoy = axr * s + axi * c, ayr * s + ayi * c
            if bent:
                nowx, nowy = drive_stage(nowx, nowy, effect)
                agox, agoy = drive_stage(agox, agoy, effect)
            if gap_x != 0.0 or gap_y != 0.0:
                # the motion in the middle of what is held, and a quarter of a cycle before
                hx, hy = (p0 * x + p1 * vx) + (p2 * y + p3 * vy), (p4 * x + p5 * vx) + (p6 * y + p7 * vy)
                qx, qy = (p1 * x - p0 * vx) + (p3 * y - p2 * vy), (p5 * x - p4 * vx) + (p7 * y - p6 * vy)
                hx, qx = hx * half_c - qx * half_s, qx * half_c + hx * half_s
                hy, qy = hy * half_c - qy * half_s, qy * half_c + hy * half_s
                nowx, nowy = nowx * (1.0 + gap_x * hx * hx), nowy * (1.0 + gap_y * hy * hy)
                agox, agoy = agox * (1.0 + gap_x * qx * qx), agoy * (1.0 + gap_y * qy * qy)
            metx, mety = nowx * half_c + agox * half_s, nowy * half_c + agoy * half_s
            powerx, powery = nowx * nowx + agox * agox, nowy * nowy + agoy * agoy
            forcex += factor * ((b0 * nowx - b1 * agox) + (b2 * nowy - b3 * agoy))
            forcey += factor * ((b4 * nowx - b5 * agox) + (b6 * nowy - b7 * agoy))
            if mode_on:
                mode1, mode2 = mode1 + mode_push * nowx, mode2 + mode_push * nowy
        forcex += (b0 * tone_x + b2 * tone_y) * tone_c - (b1 * tone_x + b3 * tone_y) * tone_s
        forcey += (b4 * tone_x + b6 * tone_y) * tone_c - (b5 * tone_x + b7 * tone_y) * tone_s
        twice_c, twice_s = c * c - s * s, 2.0 * s * c
        pushx = -(pump_xc * twice_c + pump_xs * twice_s + soft_x * metx * metx + mean_x * powerx) * x + curl * y
        pushy = -(pump_yc * twice_c + pump_ys * twice_s + soft_y * mety * mety + mean_y * powery) * y - curl * x
        if curved:
            curlx, curly = instant_force(x, y, vx * w, vy * w, nonlinear)
            pushx, pushy = pushx - curlx, pushy - curly
        if dragged:
            dragx, dragy = velocity_force(vx * w, vy * w, -w * w * x * dt, -w * w * y * dt, effect)
            pushx, pushy = pushx + dragx, pushy + dragy
        vx, vy = vx + kick_dt * pushx, vy + kick_dt * pushy
        x1 = ((f00 * x + f01 * y) + (f02 * vx + f03 * vy)) + (g00 * forcex + g01 * forcey)
        y1 = ((f10 * x + f11 * y) + (f12 * vx + f13 * vy)) + (g10 * forcex + g11 * forcey)
        vx1 = ((f20 * x + f21 * y) + (f22 * vx + f23 * vy)) + (g20 * forcex + g21 * forcey + kick * noise[n])
        vy1 = ((f30 * x + f31 * y) + (f32 * vx + f33 * vy)) + (g30 * forcex + g31 * forcey + kick * noise[n + 1])
        x, y, vx, vy = x1, y1, vx1, vy1
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        tone_c, tone_s = tone_c * step_c - tone_s * step_s, tone_s * step_c + tone_c * step_s
        n += 4
    z[0], z[1], z[2], z[3] = x, y, vx, vy
    memory[M_MODE], memory[M_MODE + 1], memory[M_MODE + 2], memory[M_MODE + 3] = mode1.real, mode1.imag, mode2.real, mode2.imag
    memory[M_TIME] += effect[E_PERIOD]
