"""Checks of the plant against closed forms; run it, it prints what it measured and fails if anything is off."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from campaign import run, scene_of
from kernel import Array, Plant
from plan import Step, draw_plan
from severity import solve
from slowflow import design, real_form, tabulate
from unit import TWO_PI, Unit, draw_unit

FAILED: list[str] = []
AVERAGED = 400


def say(name: str, value: float, limit: float) -> None:
    """Print a figure and remember it if it is beyond its limit."""
    good = abs(value) <= limit
    print(f"  {'ok  ' if good else 'FAIL'} {name:<74s} {value:10.2e}   limit {limit:.0e}", flush=True)
    if not good:
        FAILED.append(name)


def ideal(unit: Unit, **changes: object) -> Unit:
    """A unit without anisotropy, phases or feedthrough, to which a closed form applies."""
    zero = np.zeros((2, 2))
    base = {
        "split": (0.0, 0.0),
        "damping_split": (0.0, 0.0),
        "drive": np.eye(2),
        "pick": np.eye(2),
        "feed_direct": zero,
        "feed_slow": zero,
        "rate": 0.0,
        "drive_pole": np.full(2, 5e3 * unit.w0),
        "pick_pole": np.full(2, 5e3 * unit.w0),
    }
    return replace(unit, **{**base, **changes})  # type: ignore[arg-type]


def _bare(unit: Unit, omega: float = 0.0, extra: dict[str, float] | None = None) -> Plant:
    scene = scene_of(unit, [Step("a", "ftr_x", 1.0, 1.0, 40.0)], 0, quiet=True)
    scene.slow[:, 0] = omega
    par = {**scene.par, "SIGMA_V": 0.0, "SIGMA_W": 0.0, "DAC_LSB": 0.0, "ADC_LSB": 0.0, **(extra or {})}
    return Plant(par, unit.propagator(), scene.slow, 1)


def _modes(state: Array) -> tuple[complex, complex]:
    return complex(state[0], state[2]), complex(state[1], state[3])


def _azimuth(plant: Plant, unit: Unit) -> float:
    """Mean azimuth over many phases: the velocity of the turning frame makes it swing by kappa Omega / w0 within a period."""
    turned = []
    for _ in range(AVERAGED):
        x, y = _modes(plant.state)
        turned.append(0.5 * math.atan2(2.0 * (x * y.conjugate()).real, abs(x) ** 2 - abs(y) ** 2))
        plant.run({"MODE": 2, "FREQ": unit.f0}, 1)
    return float(np.mean(turned))


def ring_down(unit: Unit) -> None:
    """Free decay: time constant; with a rate, the turn of the pattern."""
    plant = _bare(ideal(unit))
    s = np.zeros(10)
    s[0] = 1.0
    plant.state = s
    windows = round(0.5 * unit.tau * unit.loop_rate)
    plant.run({"MODE": 2, "FREQ": unit.f0}, windows)
    x, _ = _modes(plant.state)
    seconds = windows / unit.loop_rate
    # the phase in (x, v/w0) is not quite that of a damped mode: average over what a quarter of a period would show
    say("ring-down: 1/tau against w0/2Q, relative", -math.log(abs(x)) / seconds * unit.tau - 1.0, 2.0 / unit.q)
    omega = 0.5
    plant = _bare(ideal(unit, q=1e12), omega)
    plant.state = s
    begin = _azimuth(plant, unit)
    # as many windows again as _azimuth takes are in the mean at both ends
    plant.run({"MODE": 2, "FREQ": unit.f0}, 2 * round(0.5 * unit.loop_rate) - AVERAGED)
    end = _azimuth(plant, unit)
    seconds = 2.0 * round(0.5 * unit.loop_rate) / unit.loop_rate
    say("turn of a free wave against -kappa Omega t, relative", (end - begin) / (-unit.kappa * omega * seconds) - 1.0, 1e-6)
    x, y = _modes(plant.state)
    say("energy of a turning wave without damping after a second, relative", abs(x) ** 2 + abs(y) ** 2 - 1.0, 1e-6)


def duffing(unit: Unit) -> None:
    """Shift of the frequency of a free cubic oscillator."""
    k3 = 0.02
    phases = []
    for k in (0.0, k3):
        plant = _bare(ideal(unit, q=1e12), extra={"DUF": k})
        s = np.zeros(10)
        s[0] = 1.0
        plant.state = s
        plant.run({"MODE": 2, "FREQ": unit.f0}, round(unit.loop_rate))
        x, _ = _modes(plant.state)
        phases.append(x)
    shift = -np.angle(phases[1] / phases[0])
    say("cubic spring: shift of the frequency against 3/8 k3 a^2, relative", shift / (0.375 * k3) - 1.0, 1e-4)
    plant = _bare(ideal(unit, q=1e12), extra={"COUL": 1e-3})
    s[0] = 1.0
    plant.state = s
    plant.run({"MODE": 2, "FREQ": unit.f0}, round(unit.loop_rate))
    # a free linear wave stays linear, so that the friction has the full shape of a sign: 2/pi times its height
    say("dry friction: loss of amplitude against 2/pi f, relative", (1.0 - abs(_modes(plant.state)[0])) / (2e-3 / math.pi) - 1.0, 1e-3)


def adiabatic(unit: Unit) -> None:
    """A stiffness that moves slowly takes the amplitude along as the inverse root of the frequency."""
    ideal_unit = ideal(unit, q=1e12)
    scene = scene_of(ideal_unit, [Step("a", "ftr_x", 1.0, 1.0, 40.0)], 0, quiet=True)
    shift = 2e-3
    scene.add("K0", 2.0 * ideal_unit.w0 * shift * np.clip(scene.t / 10.0, 0.0, 1.0))
    plant = Plant({**scene.par, "SIGMA_V": 0.0, "SIGMA_W": 0.0, "DAC_LSB": 0.0, "ADC_LSB": 0.0}, ideal_unit.propagator(), scene.slow, 1)
    s = np.zeros(10)
    s[0] = 1.0
    plant.state = s
    plant.run({"MODE": 2, "FREQ": unit.f0}, round(11.0 * unit.loop_rate))
    # impulses skew the ellipse of the motion a little: average over phases
    heights = []
    for _ in range(400):
        x, w = plant.state[0], plant.state[2]
        heights.append(x**2 + w**2 / (1.0 + 2.0 * shift))
        plant.run({"MODE": 2, "FREQ": unit.f0}, 1)
    say(
        "slow stiffness: change of the amplitude against -1/2 of the frequency's, relative",
        (math.sqrt(np.mean(heights)) - 1.0) / (-0.5 * shift) - 1.0,
        0.05,
    )


def lorentzian(unit: Unit) -> None:
    """Steady response to an open drive, against the transfer function of the sampled chain."""
    fast = replace(unit, q=300.0 if unit.kind == "ring" else 500.0, rate=0.0)
    a, b = fast.generator()
    worst = 0.0
    for offset in (-60.0, -20.0, 0.0, 35.0, 60.0):
        hz = round(fast.f0 + offset, 1)
        plant = _bare(fast)
        command = {"MODE": 2, "FREQ": hz, "VOLTX": 0.5, "VOLTY": 0.2}
        plant.run(command, round(1.0 * fast.loop_rate))
        got = plant.run(command, round(0.05 * fast.loop_rate), keep=True).mean(0)
        # the hold and its images, folded by the converter that shares its clock: the discrete transfer function is exact
        tick = 1.0 / fast.adc_rate
        block = np.zeros((12, 12))
        block[:10, :10], block[:10, 10:] = a, b
        step = expm(block * tick)
        z = np.exp(1j * TWO_PI * hz * tick)
        response = np.linalg.solve(z * np.eye(10) - step[:10, :10], step[:10, 10:])[8:10]
        want = response @ np.array([0.5, 0.2]) * np.exp(1j * fast.advance)
        have = np.array([complex(got[0], got[1]), complex(got[2], got[3])])
        worst = max(worst, float(np.max(np.abs(have - want)) / np.max(np.abs(want))))
    say("open drive, five frequencies: envelopes against the transfer function, relative", worst, 1e-6)


def static(unit: Unit) -> None:
    """Closed loops at rest: the drives against the slow flow's steady state with matrices from the physics."""
    for axis in ("x", "y"):
        quiet = run(unit, [Step(f"static_{axis}", f"ftr_{axis}", 1.0, 12.0, 2.0)], 0, quiet=True)[0].columns
        f = float(quiet["ref_freq"].mean())
        w = TWO_PI * f
        tick = 1.0 / unit.adc_rate
        a, b = unit.generator()
        block = np.zeros((12, 12))
        block[:10, :10], block[:10, 10:] = a, b
        # the table of the rates is in the impulses, so the constant rate is added to the generator here
        block[2, 3] += 2.0 * unit.kappa * unit.rate
        block[3, 2] -= 2.0 * unit.kappa * unit.rate
        step = expm(block * tick)
        h = np.linalg.solve(np.exp(1j * w * tick) * np.eye(10) - step[:10, :10], step[:10, 10:])[8:10] * np.exp(1j * unit.advance)
        u = np.array([complex(quiet[f"{k}_drive_c"].mean(), quiet[f"{k}_drive_s"].mean()) for k in "xy"])
        p = np.array([complex(quiet[f"{k}_pick_c"].mean(), quiet[f"{k}_pick_s"].mean()) for k in "xy"])
        say(
            f"{axis} oscillator at rest: pick-offs against the transfer function at the locked frequency",
            float(np.max(np.abs(h @ u - p))),
            2e-6,
        )


def healthy_slow_flow(unit: Unit, seed: int) -> None:
    """A healthy campaign without fast noise must satisfy Eq. (3), static recordings to below their noise."""
    steps = [s for s in draw_plan(unit.kind, np.random.default_rng(seed), None) if "thermal" not in s.label and not s.table]
    if unit.kind == "ring":
        steps = [s for s in steps if s.nu in (0.0, 0.1, 1.5)][:24]
    else:
        steps = [s for s in steps if s.mode != "loops_off" and "x0.5" not in s.label and s.label != "locate"][:24]
    tables = [tabulate(run(unit, steps, seed, **how), unit.f0, unit.kappa) for how in ({"quiet": True}, {})]  # type: ignore[arg-type]
    table, noisy = tables
    keep = np.isin(table.sort, ("bin", "turning", "whole", "line"))
    x = design(table)
    unknown = solve(table, x, np.where(keep, 1.0, 0.0)[:, None] * np.ones(4))
    left = real_form(table, table.left - x @ unknown)[keep]
    full = solve(noisy, design(noisy), np.where(keep, 1.0, 0.0)[:, None] * np.ones(4))
    scatter = real_form(noisy, noisy.left - design(noisy) @ full)[keep]
    sigma = 1.4826 * np.median(np.abs(scatter), 0)
    left = np.abs(left)
    names = ("amplitude", "frequency", "precession", "quadrature")
    for i, name in enumerate(names):
        say(
            f"healthy {unit.kind}: slow flow, {name}, largest residual [V/s] over the noise of a probe",
            float(left[:, i].max() / sigma[i]),
            1.0,
        )


def main() -> int:
    """Run every check."""
    for kind in ("ring", "hrg"):
        print(kind)
        unit = draw_unit(kind, np.random.default_rng([77, len(kind)]), f"{kind}-check")
        ring_down(unit)
        duffing(unit)
        adiabatic(unit)
        lorentzian(unit)
        static(unit)
        healthy_slow_flow(unit, 5)
    print("failed: " + ", ".join(FAILED) if FAILED else "all within their limits")
    return bool(FAILED)


if __name__ == "__main__":
    sys.exit(main())
