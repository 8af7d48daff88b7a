"""The tables of steps of doc/gap_campaign.md in a drawn order, without the warm open drives that these have had since, and the plans of
loggers who lacked something.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

POOR = ("no rate table", "no temperature", "one amplitude")


@dataclass(frozen=True)
class Step:
    """One command and the recording that follows it."""

    label: str
    mode: str
    amplitude: float
    settle: float
    record: float
    nu: float = 0.0  # side band [Hz]
    index: float = 0.0
    drive: str = ""  # axis of an open drive, or "body"
    volts: float = 0.0
    offset: float = 0.0  # from resonance [Hz]
    precession: float = 0.0  # periods of 4 theta per second; volts follow from the unit
    stiffness: float = 0.0
    gain: float = 0.0  # of ring-down and ring-up
    ramp: tuple[float, float] = (0.0, 0.0)  # to which temperature, in which time
    table: bool = False
    keep: bool = True

    @property
    def axis(self) -> str:
        """Axis of the oscillator, as far as the label tells."""
        return "y" if self.mode == "ftr_y" or "_y" in self.label else "x"


Blocks = list[list[Step]]


def _off(settle_locate: float, body: bool, amplitude: float, rng: np.random.Generator) -> list[Step]:
    offs = [
        Step(f"feed_{a}_{o:+d}hz", "loops_off", 0.0, 2.0, 2.0, drive=a, volts=2.0, offset=float(o))
        for a in "xy"
        for o in (-60, -20, 20, 60)
    ]
    if body:
        offs += [Step(f"body_{o:+d}hz", "loops_off", 0.0, 2.0, 4.0, drive="body", volts=4.0, offset=float(o)) for o in (-40, 40)]
    rng.shuffle(offs)
    return [Step("locate", "ftr_x", amplitude, settle_locate, 2.0, keep=body), *offs]


def _scatter(anchors: Blocks, loose: Blocks, rng: np.random.Generator) -> list[Step]:
    """Anchors at the beginning, spread over the middle and at the end; the loose blocks between them in drawn order."""
    rng.shuffle(loose)
    cuts = np.array_split(np.arange(len(loose)), len(anchors) - 1)
    out: list[Step] = []
    for anchor, cut in zip(anchors, [*cuts, np.array([], int)], strict=True):
        out += anchor
        for i in cut:
            out += loose[int(i)]
    return out


def ring_plan(rng: np.random.Generator) -> list[Step]:
    """Force to rebalance."""
    side = [
        [Step(f"side_{a}_a{v:g}_{n:g}hz", f"ftr_{a}", v, 3.0, 10.0, nu=n, index=0.1)]
        for a in "xy"
        for v in (0.6, 1.0, 1.4)
        for n in (0.1, 0.5, 1.0, 1.5)
    ]
    axes = list("xy")
    rng.shuffle(axes)
    a, b = axes
    thermal = [
        Step(f"thermal_{a}_up", f"ftr_{a}", 1.0, 3.0, 16.0, ramp=(33.0, 12.0)),
        Step(f"thermal_{b}_hot", f"ftr_{b}", 1.0, 3.0, 10.0),
        Step(f"thermal_{a}_hot", f"ftr_{a}", 1.0, 3.0, 10.0),
        Step(f"thermal_{b}_down", f"ftr_{b}", 1.0, 3.0, 16.0, ramp=(25.0, 12.0)),
    ]
    table = [Step(f"table_{a}", f"ftr_{a}", 1.0, 3.0, 10.0, table=True) for a in axes]
    anchors = []
    for i in range(3):
        rng.shuffle(axes)
        anchors.append([Step(f"static_{a}_{i}", f"ftr_{a}", 1.0, 3.0, 10.0) for a in axes])
    return _scatter(anchors, [*side, thermal, table, _off(3.0, True, 1.0, rng)], rng)


def hrg_plan(rng: np.random.Generator) -> list[Step]:
    """Whole angle; the volts of the precessions follow from the unit, their durations are those of the table."""
    period = 6.48
    table = [Step(f"table_{i}", "whole_angle", 1.0, 8.0 if i == 0 else 4.0, 10.0, table=True) for i in range(2)]

    def vir(amp: float, times: float, i: int) -> list[Step]:
        pair = [
            Step(f"vir_{s}_a{amp:g}_x{times:g}_{i}", "whole_angle", amp, 4.0, 12.96 / times, precession=g * times / period)
            for s, g in (("p", 1.0), ("n", -1.0))
        ]
        return pair if rng.uniform() < 0.5 else pair[::-1]

    def ring(a: str) -> list[Step]:
        mode = f"ftr_{a}"
        steps = [
            Step(f"static_{a}_ring", mode, 1.0, 8.0, 10.0),
            Step(f"ring_down_{a}", "ring_down", 1.0, 0.0, 3.792, gain=-2.0),
            Step(f"ring_up_{a}", "ring_up", 1.0, 0.0, 3.85, gain=2.0),
        ]
        return steps + [
            Step(f"stiffness_{a}_{i}", "stiffness", 1.0, 2.0 if i == 0 else 0.5, 3.0, stiffness=1.0 if i % 2 == 0 else -1.0)
            for i in range(4)
        ]

    thermal = [
        Step("static_x_thermal", "ftr_x", 1.0, 8.0, 10.0),
        Step("thermal_up", "whole_angle", 1.0, 4.0, 12.96, precession=1 / period, ramp=(33.0, 9.72)),
        Step("thermal_free", "whole_angle", 1.0, 4.0, 10.0),
        Step("thermal_hot", "whole_angle", 1.0, 4.0, 12.96, precession=-1 / period),
        Step("thermal_down", "whole_angle", 1.0, 4.0, 12.96, precession=1 / period, ramp=(25.0, 9.72)),
    ]
    pairs = [vir(1.0, 1.0, 0), vir(1.0, 1.0, 1), vir(0.6, 1.0, 2), vir(1.4, 1.0, 3), vir(1.0, 0.5, 4), vir(1.0, 1.5, 5)]
    rng.shuffle(pairs)
    rounds = []
    axes = list("yx")
    rng.shuffle(axes)
    for a, part in zip(axes, (pairs[:3], pairs[3:]), strict=True):
        steps = [Step(f"static_{a}_round", f"ftr_{a}", 1.0, 8.0, 10.0), Step(f"free_{a}_0", "whole_angle", 1.0, 4.0, 10.0)]
        for i, pair in enumerate(part):
            steps += [*pair, Step(f"free_{a}_{i + 1}", "whole_angle", 1.0, 4.0, 10.0)]
        rounds.append(steps)
    return _scatter(rounds, [table, ring("y"), ring("x"), thermal, _off(8.0, False, 0.01, rng)], rng)


def draw_plan(kind: str, rng: np.random.Generator, poor: str | None) -> list[Step]:
    """The plan of a kind of gyro, with what the logger did not have taken out."""
    steps = ring_plan(rng) if kind == "ring" else hrg_plan(rng)
    if poor == "no rate table":
        return [s for s in steps if not s.table]
    if poor == "no temperature":
        return [s for s in steps if "thermal" not in s.label]
    if poor == "one amplitude":
        return [s if s.mode == "loops_off" or not s.keep else replace(s, amplitude=1.0) for s in steps if s.amplitude in (1.0, 0.0, 0.01)]
    return steps
