"""Document 003: the scale factor from the ratio of the drive gains, over temperature and ageing, against the table that it replaces.

A unit is characterised in the factory (25 degC): its scale factor by rate table, one drive gain by the method of the field, and with both
the reference ratio. Then it ages (both drive gains by the same 1 to 5 %, up or down; Q by 30 %) and works somewhere from -40 to 60 degC.
The table knows the unaged unit's scale factor at every temperature exactly. Each method on the kind of sensor that the document names for
it: stiffness control on a ring, permanently beside its mission (force to rebalance); ring-down and ring-up on a hemisphere, with the drive
chain of a short virtual precession. On the hemisphere stiffness control is shown too: its resonance wanders by some 1 % of what the control
moves.

What neither sees: a change of the ratio itself, and of kappa; both go into the scale factor one to one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...device import Device, draw_unit, load_device
from ...estimation.gain_ratio import ring_gain, scale_factor, stiffness_gain, without_feedthrough
from ...experiments import Limits, Plan, Step
from ...experiments.whole_angle_plans import scale_factor_steps
from ...quantity import Quantity
from ...recording.command import Command, Excitation, Setpoints
from ...recording.recording import Campaign, Recording
from ...simulation import GyroSimulator
from ..gates import Gate, coverage, rms
from ..registry import Figures, Study
from ._wave import found_chain, identify, nominal_precession, pair_steps, record_plan, worst

#: of the scale factor on the factory's rate table, relative
_TABLE_SD = 3e-6
_LIMIT_PPM = 20.0
_FACTORY_DEGC, _FIELD_DEGC = 25.0, (-40.0, 60.0)
_GAIN_AGEING, _Q_AGEING = (0.01, 0.05), 0.3
#: stiffness control [V/V], how often it turns its sign, how long it is recorded and let settle each time [s]
_STIFFNESS, _TURNS, _DWELL_S, _TURN_SETTLE_S = 0.5, 80, 0.4, 0.4
#: ring-downs with ring-ups; precession of the short pair [deg/s]
_ROUNDS, _SPEED_DEG_S = 4, 8.0
#: open drive either side of the resonance, for the feedthrough [Hz], [V], [s]
_APART_HZ, _OPEN_V, _OPEN_S = 300.0, 1.0, 2.0
_SHOWN = {"ring/stiffness": "ring, stiffness", "hemisphere/amplitude": "hemisphere, ring-down/up"}


def run(seed: int) -> dict[str, float]:
    """One ring and one hemisphere, aged: errors of the corrected scale factor and of the table's [ppm]."""
    figures: dict[str, float] = {}
    for kind, design, measure in (("ring", "ring_15k", _of_ring), ("hemisphere", "hrg_hardware", _of_hemisphere)):
        unit = draw_unit(load_device(design), seed)
        aged, conditions = _aged(unit, seed)
        young = replace(unit, environment=replace(unit.environment, temperature_degc=conditions["temperature_degc"]))
        true, tabled = _scale(aged), _scale(young)
        figures |= {f"{kind}/{name}": value for name, value in conditions.items()}
        figures[f"{kind}/table"] = 1e6 * (tabled / true - 1.0)
        factory, field = (measure(device, [seed, place]) for place, device in enumerate((unit, aged)))
        table_error = 1.0 + _TABLE_SD * float(np.random.default_rng([seed, 7]).standard_normal())
        kappa, amplitude = unit.factory_data.angular_gain_kappa, unit.factory_data.nominal_amplitude_v
        for method, gain in field.items():
            # the factory's ratio: S = kappa Ac rho / g (document 003, Eqs. 9 and 13), solved for rho
            before = factory[method]
            ratio = _scale(unit) * table_error * before.value / (kappa * amplitude)
            known = Quantity(ratio, ratio * math.hypot(before.sd / before.value, _TABLE_SD), "1")
            found = scale_factor(gain, "x", known, kappa, amplitude)
            figures[f"{kind}/{method}"] = 1e6 * (found.value / true - 1.0)
            figures[f"{kind}/{method}/sd"] = 1e6 * found.sd / abs(true)
    return figures


def _aged(unit: Device, seed: int) -> tuple[Device, dict[str, float]]:
    """The unit after years, at some temperature."""
    rng = np.random.default_rng([seed, 9])
    temperature = float(rng.uniform(*_FIELD_DEGC))
    gain = 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(*_GAIN_AGEING))
    quality = 1.0 + float(rng.choice([-1.0, 1.0])) * _Q_AGEING
    aged = replace(
        unit,
        drive=replace(unit.drive, gain_m_s2_per_v=gain * unit.drive.gain_m_s2_per_v),
        resonator=replace(unit.resonator, quality_factor=quality * unit.resonator.quality_factor),
        environment=replace(unit.environment, temperature_degc=temperature),
    )
    return aged, {"temperature_degc": temperature, "gain": gain, "quality": quality}


def _scale(device: Device) -> float:
    """True slope of the rate channel, x as the oscillator [V/(rad/s)]."""
    return GyroSimulator(device, rng=np.random.default_rng(0), noisy=False).truth().scale_factor_v_per_rad_s


def _of_ring(device: Device, stream: list[int]) -> Mapping[str, Quantity]:
    """Stiffness control beside the mission, the feedthrough of the drives taken out.

    With the feedthrough E the loops hold |V| where the wave has |p_x| = |V - E_xx u_x|, and the rebalance drive acts by G_yy - A_yy E_yy:
    the running scale factor is up by ``h Im(E_xx + E_yy)``, h = u_x/V in phase with velocity = 1/(g tau), and changes with Q thereby.
    """
    recordings = list(_record(device, [*_open_steps(), *_stiffness_steps(_STIFFNESS, "ftr_x")], stream))
    feedthrough = [_feedthrough([r for r in recordings if r.label.startswith(f"open_{axis}")], k) for k, axis in enumerate("xy")]
    turns = [without_feedthrough(r, np.diag([feedthrough[0], 0.0])) for r in recordings if r.label.startswith("turn")]
    held = float(np.mean([np.mean((r.drive[:, 0] / r.pick[:, 0]).imag) for r in turns]))
    gain = stiffness_gain(turns, "x")
    return {"stiffness": gain.scaled(1.0 / (1.0 + held * (feedthrough[0] + feedthrough[1]).imag), gain.unit)}


def _of_hemisphere(device: Device, stream: list[int]) -> Mapping[str, Quantity]:
    """Ring-down and ring-up with the drive chain of a short pair; stiffness control for comparison."""
    factory = device.factory()
    rings = [s for s in scale_factor_steps(factory, "quick") if s.label in ("place_x", "ring_down_x", "ring_up_x")]
    pair = pair_steps(factory, math.radians(_SPEED_DEG_S) / nominal_precession(factory), 1, free_s=5.0)
    campaign = _record(device, [*rings * _ROUNDS, *pair, *_stiffness_steps(2.0 * _STIFFNESS, "ftr_x")], stream)
    chain, _ = found_chain(identify(replace(campaign, recordings=tuple(r for r in campaign if not r.label.startswith("turn"))), device))
    legs = [r for r in campaign if r.label.startswith("ring")]
    turns = [r for r in campaign if r.label.startswith("turn")]
    return {"amplitude": ring_gain(legs, "x", chain=chain).gain, "stiffness": stiffness_gain(turns, "x")}


def _record(device: Device, steps: Sequence[Step], stream: list[int]) -> Campaign:
    return record_plan(device, Plan("scale", tuple(steps), Limits(base_rate_rad_s=10.0)), np.random.default_rng([*stream, 3]))


def _stiffness_steps(volts_per_volt: float, mode: str) -> list[Step]:
    """CR of alternating sign; the frequency settles before it is recorded."""
    steps = [Step("place", Command(mode, setpoints=Setpoints(1.0)), 1.0, 4.0)]
    for turn in range(_TURNS):
        setpoints = Setpoints(1.0, stiffness_v_per_v=volts_per_volt * (-1.0) ** turn)
        steps.append(Step(f"turn_{turn}", Command(mode, setpoints=setpoints), _DWELL_S, _TURN_SETTLE_S))
    return steps


def _open_steps() -> list[Step]:
    """Each drive, open, as far above the resonance as below."""
    steps = [Step("locate", Command("ftr_x", setpoints=Setpoints(1.0)), 1.0, 4.0)]
    for axis in "xy":
        command = Command("loops_off", Excitation("drive", 1.0, volts=_OPEN_V, axis=axis))
        steps += [Step(f"open_{axis}_{k}", command, _OPEN_S, 4.0, detuning_hz=sign * _APART_HZ) for k, sign in enumerate((1.0, -1.0))]
    return steps


def _feedthrough(recordings: Sequence[Recording], axis: int) -> complex:
    """E_xx or E_yy: the mean of both sides, where the resonator's own answers are opposite (their in-phase part to 1 % only)."""
    sides = [complex(r.pick[:, axis].mean() / r.drive[:, axis].mean()) for r in recordings]
    return sum(sides) / len(sides)


def summarise(figures: Figures) -> Sequence[Gate]:
    """Both methods within the issue's limit, and the table beside them."""
    gates = []
    for key, words in _SHOWN.items():
        kind = key.split("/")[0]
        table, found = rms(figures[f"{kind}/table"], "ppm"), rms(figures[key], "ppm")
        gates.append(Gate(f"{words}: stored table, rms error", table))
        gates.append(Gate(f"{words}: corrected, rms error", found, upper=_LIMIT_PPM))
        gates.append(worst(f"{words}: corrected, worst unit", figures[key], "ppm"))
        gates.append(Gate(f"{words}: claimed sd, rms", rms(figures[f"{key}/sd"], "ppm")))
        gates.append(Gate(f"{words}: 95 % intervals cover", coverage(figures[key], figures[f"{key}/sd"])))
        gates.append(Gate(f"{words}: table over corrected", Quantity(table.value / found.value, 0.0, "1"), lower=100.0))
    gates.append(Gate("hemisphere, stiffness: corrected, rms error", rms(figures["hemisphere/stiffness"], "ppm")))
    gates.append(Gate("hemisphere, stiffness: claimed sd, rms", rms(figures["hemisphere/stiffness/sd"], "ppm")))
    return gates


def plot(figures: Figures, theme: Any) -> Any:
    """Error of the table and of the corrected scale factor of every unit over temperature."""
    from ...report.figures import Drawing
    from ...report.theme import figure

    with figure(theme, 1, 2) as (drawn, axes):
        for panel, (key, words) in zip(axes, _SHOWN.items(), strict=True):
            kind = key.split("/")[0]
            temperature = np.asarray(figures[f"{kind}/temperature_degc"])
            panel.axhspan(-_LIMIT_PPM, _LIMIT_PPM, color=theme.grid, alpha=0.6, linewidth=0.0, label=f"±{_LIMIT_PPM:g} ppm")
            panel.plot(temperature, figures[f"{kind}/table"], "^", color=theme.series[1], label="stored table")
            panel.plot(temperature, figures[key], "o", color=theme.series[0], label=words)
            panel.set_yscale("symlog", linthresh=100.0)
            panel.set_xlabel("temperature [degC]")
            panel.set_ylabel("scale-factor error [ppm]")
            panel.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=3, borderaxespad=0.1, handlelength=1.2)
    found = [float(np.sqrt(np.mean(np.square(figures[key])))) for key in _SHOWN]
    conclusion = "Aged gyros: {:.2g} ppm rms by stiffness control (ring), {:.2g} ppm by ring-down and ring-up (hemisphere).".format(*found)
    return Drawing("gain_ratio", "Scale factor from the ratio of the drive gains", conclusion, drawn)


STUDY = Study(
    name="gain-ratio",
    description="Document 003: scale factor over temperature and ageing by stiffness control and by ring-down/up, against a stored table",
    run=run,
    summarise=summarise,
    default_seeds=100,
    plot=plot,
)
