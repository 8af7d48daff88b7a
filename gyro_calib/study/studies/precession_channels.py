"""Single-channel (time-division multiplexed) against dual-channel electronics: the same hemisphere, the same plan, the same noise.

A multiplexed pick-off is read for a share of the time and held in between, later for one axis than for the other, and its chain has a delay
and a crosstalk; what the method finds is the drive chain as that controller sees it. Each drive acts in a slot of its own: a wave that is
driven round moves in steps, and its readings lag on them by a control period, which the joint fit finds and takes out. Less of the
time is read, 0.8 of a slot in four: the pick-off noise is 2.2 times as large, where the flicker of the drives does not bound the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...device import Device, load_device
from ...experiments import Limits, virtual_precession_plan
from ...quantity import Quantity
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._wave import CHAIN, chain_vector, found_chain, identify, record_plan, true_chain, worst

CHANNELS = ("dual", "single")
_WORDS = ("ΔG", "2δ", "2λ")
#: quality of the plan: 2 deg/s
_PLAN = "standard"
#: of the multiplexed read chain: settling, delay, crosstalk
_SETTLING, _DELAY_S, _CROSSTALK = 0.2, 1e-7, 1e-3
#: 1e-4, 5e-4 and 1e-3 of document 004's Table 1 (issue), absolute
_LIMITS = (1e-5, 2.5e-5, 1e-5)
#: sample deviations of the same noise, read by other electronics, scatter too
_SAME = 1.2


def _device(seed: int, channels: str) -> Device:
    """The hardware gyro of document 004 with its axes drawn, read one way or the other."""
    device = load_device("hrg_hardware")
    split, damping = np.random.default_rng([seed, 1]).uniform(0.0, np.pi / 2, size=2)
    chain = replace(device.multiplexing, enabled=channels == "single", settling_share=_SETTLING, delay_s=_DELAY_S, crosstalk=_CROSSTALK)
    axes = replace(device.resonator, split_azimuth_rad=float(split), damping_azimuth_rad=float(damping))
    return replace(device, resonator=axes, multiplexing=chain)


def run(seed: int) -> dict[str, float]:
    """Errors of the drive chain with each kind of electronics, and over their claimed sd."""
    figures: dict[str, float] = {}
    for channels in CHANNELS:
        device = _device(seed, channels)
        plan = virtual_precession_plan(device.factory(), quality=_PLAN, limits=Limits(base_rate_rad_s=1.0))
        estimate = identify(record_plan(device, plan, np.random.default_rng([seed, 2])), device)
        chain, sd = found_chain(estimate)
        error = chain_vector(chain) - true_chain(device, temperature_degc=estimate.flow.temperature_degc)
        for k, name in enumerate(CHAIN):
            figures |= {f"{channels}/{name}": error[k], f"{channels}/{name}/sd": error[k] / sd[k]}
    return figures


def summarise(figures: Figures) -> Sequence[Gate]:
    """Each within the limits of Table 1, and both alike."""
    gates = []
    for name, words, limit in zip(CHAIN, _WORDS, _LIMITS, strict=True):
        unit = "1" if name == "delta_g" else "rad"
        size = {}
        for channels in CHANNELS:
            error = rms(figures[f"{channels}/{name}"], unit)
            size[channels] = error.value
            gates.append(Gate(f"{words}: {channels} channel, error, rms", error))
            gates.append(worst(f"{words}: {channels} channel, error, worst unit", figures[f"{channels}/{name}"], unit, upper=limit))
            gates.append(Gate(f"{words}: {channels} channel, error/sd, rms", rms(figures[f"{channels}/{name}/sd"], "1")))
        # the noise is the same in both, so their ratio is known far better than either
        apart = rms(np.asarray(figures[f"single/{name}"]) - np.asarray(figures[f"dual/{name}"]), unit)
        ratio = Quantity(size["single"] / size["dual"], apart.value / size["dual"] / np.sqrt(len(figures[f"dual/{name}"])), "1")
        gates.append(Gate(f"{words}: single over dual channel, rms errors", ratio, upper=_SAME))
    return gates


def plot(figures: Figures, theme: Any) -> Any:
    """Errors of both kinds of electronics, unit by unit."""
    from ...report.figures import Drawing
    from ...report.theme import figure

    with figure(theme, 1, 3) as (drawn, axes):
        for panel, name, words in zip(axes, CHAIN, _WORDS, strict=True):
            single, dual = (1e6 * np.asarray(figures[f"{c}/{name}"]) for c in ("single", "dual"))
            span = 1.1 * float(max(np.max(np.abs(single)), np.max(np.abs(dual)), 1e-3))
            panel.plot([-span, span], [-span, span], color=theme.muted, linewidth=1.0, label="equal")
            panel.plot(dual, single, "o", color=theme.series[0], label="one unit each")
            panel.set_xlabel(f"{words} error, dual channel [1e-6]")
            panel.set_ylabel(f"{words} error, single channel [1e-6]")
            panel.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1)
    rows = [[float(np.sqrt(np.mean(np.square(figures[f"{c}/{name}"])))) for name in CHAIN] for c in ("single", "dual")]
    times = ", ".join(f"{single / dual:.2g}" for single, dual in zip(*rows, strict=True))
    conclusion = f"The drives' own noise puts points on the line; single over dual channel, rms errors of ΔG, 2δ, 2λ: {times}."
    return Drawing("channels", "Single- against dual-channel electronics", conclusion, drawn)


STUDY = Study(
    name="precession-channels",
    description="Drive chain by virtual precession with single-channel (multiplexed) and dual-channel electronics, carrier level",
    run=run,
    summarise=summarise,
    default_seeds=50,
    plot=plot,
)
