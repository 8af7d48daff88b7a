"""Document 004, section 5.2: the hardware gyro identified, compensated and identified again; its bias instability before and after.

Hours of whole angle run on the slow flow; every seed shows on its first campaign that the carrier gives the same. The noise of the device
is flicker of its drives: it bounds what a compensation can be identified to (volts of flicker over volts of virtual precession), so the
package identifies with fast precession, where the document's 0.1 deg/s is bound at some 4e-5 (dG, 2 delta) and 7e-5 (2 lambda).

Of its bias instability (3.0950 -> 0.0511 deg/h) the document says "the lowest point of the Allan standard deviation curve", sense axis to
the east; not whether the wave precessed, nor for how long, nor with what angle noise. A lowest point does not see an error that moves
slower than its averaging time, so four readings are given: lowest point of a free wave, deviation of a free wave over an hour, and the
largest deviation while the wave turns at 0.1 deg/s, where the errors of the drive chain go round every quarter of an hour: driven round by
virtual precession, and turned by a constant input rate as on a vehicle.

``compensated`` is the drive chain alone, the document's aim: what it leaves is the device's uneven damping of 0.2 %. ``product`` is what
``self_calibrate`` puts in force (:func:`gyro_calib.calibration.compensate`): drive chain and uneven damping in one matrix, for a free wave.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...calibration import compensate
from ...device import Device, load_device
from ...estimation.allan import allan_variance
from ...estimation.angle_drift import AngleDrift, measured_drift
from ...estimation.drive_chain import compensation_matrix, iterated_compensation
from ...estimation.precession import difference_and_sum, virtual_precession_gain, volts_for
from ...experiments import Limits, Plan, SimulatedInstrument, virtual_precession_plan
from ...quantity import Quantity
from ...recording.rate import raw_rate, wave_azimuth
from ...recording.recording import Recording
from ...simulation import GyroSimulator
from ...units import DEG_H
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._wave import (
    CHAIN,
    IDENTITY,
    binned_precession,
    chain_vector,
    compensated,
    found_chain,
    identify,
    pair_steps,
    precession_command,
    record_plan,
    true_chain,
    worst,
)

FloatArray = NDArray[np.float64]
_WORDS, _UNITS = ("ΔG", "2δ", "2λ"), ("ppm", "µrad", "µrad")
#: residuals that the issue allows, and those of the document [1e-6]
_LIMITS, _DOCUMENT, _MICRO = (1.0, 1.0, 10.0), (7.3, 4.3, 270.0), 1e6
_SPEED_RAD_S = math.radians(0.1)
_ROUNDS = 3
#: bins of the picture, and periods that fill them all whatever the drift
_BINS, _DRAWN_PERIODS = 32, 1.06
_FREE_S, _PRECESSING_S, _MEAN_S = 3 * 3600.0, 1.5 * 3600.0, 1.0
_TAU_S: Mapping[str, tuple[int, ...]] = {
    "free": (2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 1800, 3600),
    "precessing": (2, 4, 8, 16, 32, 64, 128, 256, 330, 450, 620, 900, 1350, 1800),
    "turned": (2, 4, 8, 16, 32, 64, 128, 256, 330, 450, 620, 900, 1350, 1800),
}
#: what is shown of each test
_STATES: Mapping[str, tuple[str, ...]] = {
    "free": ("before", "compensated", "product", "ideal"),
    "precessing": ("before", "compensated", "ideal"),
    "turned": ("before", "compensated", "product", "ideal", "even"),
}
#: ``ideal``: the same device without errors of the drive chain, ``even``: without uneven damping either. Beside them while the wave
#: precesses: the drift against azimuth, measured on the pair, taken out as well
_CORRECTED = ("compensated, drift out", "ideal, drift out")


def _plan(device: Device, quality: str) -> Plan:
    return virtual_precession_plan(device.factory(), quality=quality, limits=Limits(base_rate_rad_s=1.0))


def _pair(device: Device, volts: float, compensation: FloatArray, seed: int, stream: int, periods: float = 1.0) -> list[Recording]:
    """Both senses at 0.1 deg/s over a period of 4 theta, a compensation in force."""
    plan = Plan("pair", tuple(pair_steps(device.factory(), volts, periods, compensation)))
    return list(record_plan(device, plan, np.random.default_rng([seed, stream]), fidelity="slow_flow"))[-2:]


def _iterated(device: Device, seed: int, figures: dict[str, float]) -> FloatArray:
    """Identify with fast precession, compensate, repeat; true residuals and claimed sd of every round."""
    matrix = IDENTITY
    for turn in range(_ROUNDS):
        plan, stream = compensated(_plan(device, "quick"), matrix), [seed, 10 + turn]
        estimate = identify(record_plan(device, plan, np.random.default_rng(stream), fidelity="slow_flow"), device)
        chain, sd = found_chain(estimate, matrix)
        if turn == 0:
            at_carrier = identify(record_plan(device, plan, np.random.default_rng(stream), fidelity="carrier"), device)
            apart = chain_vector(found_chain(at_carrier)[0]) - chain_vector(chain)
            figures |= {f"{name}/carrier - slow flow": apart[k] for k, name in enumerate(CHAIN)}
        matrix = iterated_compensation(matrix, chain)
        left = true_chain(device, matrix)
        for k, name in enumerate(CHAIN):
            figures |= {f"{name}/residual {turn + 1}": left[k], f"{name}/sd {turn + 1}": sd[k]}
    return matrix


def _document(device: Device, seed: int, figures: dict[str, float]) -> float:
    """The document's steps 4 to 9: three amplitudes, the volts of 0.1 deg/s (returned), the pair, its compensation, the pair again."""
    campaign = record_plan(device, _plan(device, "fine"), np.random.default_rng([seed, 1]), fidelity="slow_flow")
    by_label = {r.label: r for r in campaign}
    gain, _ = virtual_precession_gain([by_label["vir_p_0"], by_label["vir_x1.5"], by_label["vir_x2"]])
    volts = volts_for(_SPEED_RAD_S, gain)
    before = _pair(device, volts, IDENTITY, seed, 2)
    matrix = compensation_matrix(difference_and_sum(*before).chain)
    again = difference_and_sum(*_pair(device, volts, matrix, seed, 3)).chain
    left = true_chain(device, matrix)
    for k, name in enumerate(CHAIN):
        figures |= {f"{name}/document's method": left[k], f"{name}/document's method, as it sees it": chain_vector(again)[k]}
    return volts


def _product(device: Device, seed: int, figures: dict[str, float]) -> FloatArray:
    """What the package's own rounds put in force for drive chain and uneven damping; their number, and the drift predicted to be left."""
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 20]), fidelity="slow_flow")
    plan = _plan(device, "quick")
    found = compensate(SimulatedInstrument(simulator), plan, plan)
    drift = [found.result.parameters[f"drift_{part}_4theta"].value for part in ("cos", "sin")]
    figures |= {"product/rounds": float(len(found.rounds)), "product/drift left [deg/h]": math.hypot(*drift) / DEG_H}
    return np.reshape(found.mission.compensation, (2, 2))


def _without_errors(device: Device, *, even: bool = False) -> Device:
    ideal = replace(device, drive=replace(device.drive, gain_mismatch=0.0, two_delta_rad=0.0, two_lambda_rad=0.0))
    return replace(ideal, resonator=replace(device.resonator, damping_anisotropy=0.0)) if even else ideal


def _rates(
    device: Device,
    volts: float,
    matrix: FloatArray,
    duration_s: float,
    seed: int,
    drift: AngleDrift | None,
    input_rate_rad_s: float,
) -> Iterator[FloatArray]:
    """Rate of the firmware in means over a second [rad/s]; then the same with the drift against azimuth taken out."""
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 5]), fidelity="slow_flow")
    simulator.advance(5.0)
    simulator.configure(precession_command(volts, matrix))
    simulator.advance(60.0, input_rate_rad_s)
    rows = simulator.advance(duration_s, input_rate_rad_s)
    rate = raw_rate(rows, simulator.command, simulator.factory)
    width = round(_MEAN_S * simulator.sample_rate_hz)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(values[: values.size // width * width].reshape(-1, width).mean(axis=1))

    yield means(rate)
    if drift is not None:
        yield means(rate - drift.at(wave_azimuth(rows)))


def _allan(device: Device, volts: float, matrices: Mapping[str, FloatArray], seed: int) -> dict[str, float]:
    """Allan deviations [deg/h] of every state in every test; the same noise in all."""
    figures: dict[str, float] = {}
    kappa = device.factory_data.angular_gain_kappa
    tests = {
        "free": (0.0, _FREE_S, 0.0),
        "precessing": (volts, _PRECESSING_S, 0.0),
        "turned": (0.0, _PRECESSING_S, 2.0 * _SPEED_RAD_S / kappa),
    }
    for test, (turn, duration, input_rate) in tests.items():
        for state in _STATES[test]:
            gyro = _without_errors(device, even=state == "even") if state in ("ideal", "even") else device
            matrix = matrices.get(state, IDENTITY)
            drift = None
            if test == "precessing" and state != "before":
                forward, backward = _pair(gyro, volts, matrix, seed, 4)
                drift = measured_drift(forward, backward, kappa)
            rates = _rates(gyro, turn, matrix, duration, seed, drift, input_rate)
            for name, rate in zip((state, f"{state}, drift out"), rates, strict=False):
                variance = allan_variance(rate, 1.0 / _MEAN_S, _TAU_S[test])
                figures |= {f"allan/{test}/{name}/{tau}": math.sqrt(v) / DEG_H for tau, v in zip(_TAU_S[test], variance, strict=True)}
    return figures


def run(seed: int) -> dict[str, float]:
    """One run of the gyro of the document: residuals of ours and of the document's method, Allan deviations before and after."""
    device = load_device("hrg_hardware")
    figures: dict[str, float] = {}
    volts = _document(device, seed, figures)
    matrix = _iterated(device, seed, figures)
    figures |= {"volts": volts} | {f"compensation/{k}": float(c) for k, c in enumerate(matrix.ravel())}
    return figures | _allan(device, volts, {"compensated": matrix, "product": _product(device, seed, figures)}, seed)


def _curve(figures: Figures, test: str, state: str) -> FloatArray:
    """Allan deviation over averaging times [deg/h], root mean square over the seeds."""
    return np.array([float(np.sqrt(np.mean(np.square(figures[f"allan/{test}/{state}/{tau}"])))) for tau in _TAU_S[test]])


def _reading(figures: Figures, reading: str, state: str) -> float:
    """One number of a curve [deg/h]: ``lowest`` and ``hour`` of the free wave, else the largest beyond a minute of that test."""
    if reading in ("precessing", "turned"):
        return float(_curve(figures, reading, state)[np.array(_TAU_S[reading]) > 60].max())
    curve = _curve(figures, "free", state)
    return float(curve.min() if reading == "lowest" else curve[-1])


def summarise(figures: Figures) -> Sequence[Gate]:
    """Residuals against their limits or bounds, and bias instability."""
    gates = []
    for name, words, unit, limit, published in zip(CHAIN, _WORDS, _UNITS, _LIMITS, _DOCUMENT, strict=True):

        def size(what: str, name: str = name, unit: str = unit) -> Quantity:
            return rms(_MICRO * np.asarray(figures[f"{name}/{what}"]), unit)

        bound = size(f"sd {_ROUNDS}")
        gates += [Gate(f"{words} left after round {turn}, rms", size(f"residual {turn}")) for turn in range(1, _ROUNDS)]
        gates.append(Gate(f"{words}: noise bound of a round", bound))
        left = size(f"residual {_ROUNDS}")
        gates.append(Gate(f"{words} left after round {_ROUNDS}, rms (document {published:g})", left, upper=max(limit, bound.value)))
        gates.append(Gate(f"{words} left by the document's method, rms", size("document's method")))
        gates.append(Gate(f"{words} left by it, as it identifies it, rms", size("document's method, as it sees it")))
        apart = figures[f"{name}/carrier - slow flow"]
        gates.append(worst(f"{words}: carrier − slow flow, worst seed", apart, unit, _MICRO, upper=limit))
    return [*gates, *_instability(figures)]


def _gain_limits(reading: str) -> dict[str, float]:
    return {"lower": 60.0} if reading == "turned" else {}


def _instability(figures: Figures) -> list[Gate]:
    def gate(name: str, value: float, unit: str, **limits: float) -> Gate:
        return Gate(name, Quantity(value, 0.0, unit), **limits)

    gates = []
    for reading, words in (
        ("lowest", "free, lowest"),
        ("hour", "free, 1 h"),
        ("precessing", "precessing, largest"),
        ("turned", "turned, largest"),
    ):
        states = _STATES.get(reading, _STATES["free"]) + (_CORRECTED if reading == "precessing" else ())
        value = {state: _reading(figures, reading, state) for state in states}
        gates += [gate(f"Allan {words}: {state}", value[state], "deg/h") for state in states]
        gates.append(gate(f"{words}: before / compensated", value["before"] / value["compensated"], "1"))
        gates.append(gate(f"{words}: compensated / ideal", value["compensated"] / value["ideal"], "1", upper=1.2))
        if reading == "precessing":
            first, ideal = _CORRECTED
            gates.append(gate(f"{words}: before / {first}", value["before"] / value[first], "1", lower=60.0))
            gates.append(gate(f"{words}: {first} / {ideal}", value[first] / value[ideal], "1", upper=1.2))
        else:
            # a free wave on a base that does not turn says little of what goes round with it
            gates.append(gate(f"{words}: before / product", value["before"] / value["product"], "1", **_gain_limits(reading)))
            even = "even" if reading == "turned" else "ideal"
            gates.append(gate(f"{words}: product / {even}", value["product"] / value[even], "1", upper=1.2))
    gates.append(gate("product: rounds, mean", float(np.mean(figures["product/rounds"])), "1"))
    gates.append(
        gate("product: drift against azimuth, predicted, rms", float(rms(figures["product/drift left [deg/h]"], "deg/h").value), "deg/h")
    )
    return gates


def plot(figures: Figures, theme: Any) -> Any:
    """Rate against 4 theta before and after (document's Figs. 15 and 16; seed 0) and the Allan deviations (Fig. 17; all seeds)."""
    from ...report.figures import Drawing
    from ...report.theme import figure

    device, volts = load_device("hrg_hardware"), float(figures["volts"][0])
    found = np.array([figures[f"compensation/{k}"][0] for k in range(4)]).reshape(2, 2)
    to_rate = 2.0 / device.factory_data.angular_gain_kappa / DEG_H
    with figure(theme, 2, 3) as (drawn, grid):
        width, height = drawn.get_size_inches()
        drawn.set_size_inches(width, 2 * height)
        for row, (matrix, state) in zip(grid, ((IDENTITY, "before"), (found, "compensated")), strict=True):
            (angle, forward), (_, backward) = (binned_precession(r, _BINS) for r in _pair(device, volts, matrix, 0, 2, _DRAWN_PERIODS))
            row[0].plot(angle, 1e3 * np.degrees(np.abs(forward)), "o", color=theme.series[0], label=f"+u, magnitude, {state}")
            row[0].plot(angle, 1e3 * np.degrees(np.abs(backward)), "^", color=theme.series[1], label=f"−u, magnitude, {state}")
            row[0].set_ylabel("precession θ′ [mdeg/s]")
            difference = forward - backward
            words = f"difference less its mean, {state}"
            row[1].plot(angle, to_rate * (difference - difference.mean()), "o", color=theme.series[0], label=words)
            row[1].plot(angle, to_rate * (forward + backward), "^", color=theme.series[1], label=f"sum, {state}")
            row[1].set_ylabel("as input rate [deg/h]")
            for panel in row[:2]:
                panel.set_xlabel("4θ [deg]")
                panel.set_xticks(range(0, 361, 90))
        for panel, test in ((grid[0][2], "free"), (grid[1][2], "turned")):
            states = _STATES[test]
            for state, colour, mark in zip(states, (*theme.series[1::-1], *theme.series[2:]), "os^vD", strict=False):
                panel.plot(_TAU_S[test], _curve(figures, test, state), f"{mark}-", color=colour, label=f"{test}: {state}")
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xlabel("averaging time τ [s]")
            panel.set_ylabel("Allan deviation [deg/h]")
        for panel in grid.ravel():
            panel.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), borderaxespad=0.1)
    before, after = (_reading(figures, "turned", state) for state in ("before", "product"))
    conclusion = f"Turning at 0.1 deg/s: {before:.3g} deg/h before, {after:.2g} deg/h with drives and uneven damping compensated."
    return Drawing("hardware", "The gyro of document 004's experiments", conclusion, drawn)


STUDY = Study(
    name="precession-hardware",
    description="Document 004, hardware gyro: drive chain identified, compensated, iterated; bias instability before and after",
    run=run,
    summarise=summarise,
    default_seeds=12,
    plot=plot,
)
