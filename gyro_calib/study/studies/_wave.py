"""What the whole-angle studies share: virtual precession of a simulated hemisphere, its drive chain against the hidden truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device import Device
from ...errors import DataError
from ...estimation.drive_chain import DriveChain, drive_chain_of
from ...estimation.wave import smooth_angle
from ...estimation.whole_angle_fit import WholeAngleEstimate, fit_whole_angle, usable_wave_recordings
from ...experiments import Plan, SimulatedInstrument, Step, run_plan
from ...experiments.whole_angle_plans import nominal_gain
from ...quantity import Quantity
from ...recording.command import Command, Setpoints
from ...recording.rate import wave_azimuth
from ...recording.recording import Campaign, Recording
from ...simulation import GyroSimulator
from ..gates import Gate

__all__ = [
    "CHAIN",
    "IDENTITY",
    "binned_precession",
    "chain_vector",
    "compensated",
    "found_chain",
    "identify",
    "nominal_precession",
    "pair_steps",
    "precession_command",
    "record_plan",
    "true_chain",
    "worst",
]

FloatArray = NDArray[np.float64]
#: the three errors of the drive chain (document 004, Eq. 21)
CHAIN = ("delta_g", "two_delta", "two_lambda")
IDENTITY = np.eye(2)
#: how much longer than its periods a run lasts, time to settle after a command and on the first axis [s]
_MARGIN, _SETTLE_S, _PLACE_S = 1.06, 2.0, 8.0
#: smoothing of the azimuth before its precession is drawn [s]
_SMOOTH_S = 0.3


def nominal_precession(factory: Mapping[str, Any]) -> float:
    """Precession theta' per volt of the nominal unit [rad/s/V]."""
    return 0.5 * nominal_gain(factory) / float(factory["nominal_amplitude_v"])


def precession_command(volts: float, compensation: FloatArray = IDENTITY) -> Command:
    """Whole angle at 1 V with this virtual precession and drive compensation."""
    matrix = tuple(float(c) for c in np.ravel(compensation))
    return Command("whole_angle", setpoints=Setpoints(1.0, virtual_precession_v=volts), compensation=matrix)  # type: ignore[arg-type]


def pair_steps(
    factory: Mapping[str, Any], volts: float, periods: float, compensation: FloatArray = IDENTITY, *, free_s: float = 20.0
) -> list[Step]:
    """Wave on x, a free run, then virtual precession of both senses over about so many periods of 4 theta."""
    duration = _MARGIN * periods * 0.5 * math.pi / (abs(volts) * nominal_precession(factory))
    steps = [Step("place", Command("ftr_x", setpoints=Setpoints(1.0)), 2.0, _PLACE_S)]
    steps.append(Step("free", precession_command(0.0, compensation), free_s, _SETTLE_S))
    for name, sign in (("p", 1.0), ("n", -1.0)):
        steps.append(Step(f"vir_{name}", precession_command(sign * volts, compensation), duration, _SETTLE_S))
    return steps


def compensated(plan: Plan, compensation: FloatArray) -> Plan:
    """The plan with a drive compensation in force throughout."""
    matrix = tuple(float(c) for c in np.ravel(compensation))
    steps = [replace(s, command=replace(s.command, compensation=matrix)) for s in plan.steps]  # type: ignore[arg-type]
    return replace(plan, steps=tuple(steps), final=replace(plan.final, compensation=matrix))  # type: ignore[arg-type]


def record_plan(device: Device, plan: Plan, rng: np.random.Generator, *, fidelity: str = "carrier", noisy: bool = True) -> Campaign:
    """Run a plan on a fresh simulation of the device at rest."""
    return run_plan(SimulatedInstrument(GyroSimulator(device, rng=rng, fidelity=fidelity, noisy=noisy)), plan)


def identify(campaign: Campaign, device: Device) -> WholeAngleEstimate:
    """The package's joint fit on a campaign."""
    factory = device.factory_data
    return fit_whole_angle(usable_wave_recordings(campaign)[0], math.pi * factory.nominal_f0_hz / factory.nominal_q)


def found_chain(estimate: WholeAngleEstimate, compensation: FloatArray = IDENTITY) -> tuple[DriveChain, FloatArray]:
    """What is left of (dG, 2 delta, 2 lambda) with a compensation in force, and its standard deviations, shape (3,)."""
    flow = estimate.flow
    vector = flow.vector()

    def chain(values: FloatArray) -> FloatArray:
        return chain_vector(drive_chain_of(flow.unpack(values).G @ compensation))

    deviations = np.sqrt(np.diag(flow.covariance))
    steps = np.diag(deviations)
    jacobian = np.column_stack([(chain(vector + h) - chain(vector - h)) / (2.0 * h.sum()) for h in steps])
    return drive_chain_of(flow.values.G @ compensation), np.sqrt(np.diag(jacobian @ flow.covariance @ jacobian.T))


def true_chain(device: Device, compensation: FloatArray = IDENTITY, temperature_degc: float | None = None) -> FloatArray:
    """(dG, 2 delta, 2 lambda) of the device as its controller sees them with a compensation in force, shape (3,)."""
    return chain_vector(drive_chain_of(device.slow_flow(0.0, temperature_degc).G @ compensation))


def chain_vector(chain: DriveChain) -> FloatArray:
    """(dG, 2 delta, 2 lambda), shape (3,)."""
    return np.array([chain.delta_g, chain.two_delta, chain.two_lambda])


def binned_precession(recording: Recording, bins: int) -> tuple[FloatArray, FloatArray]:
    """Middle of bins of 4 theta over a turn [deg], and the mean precession theta' in each [rad/s], shape (bins,): by the time that the wave
    takes from edge to edge, so that it does not matter where in a bin the rows lie.

    Raises
    ------
    DataError
        The wave turned by less than a bin more than a period.
    """
    psi = smooth_angle(2.0 * wave_azimuth(recording.data), round(_SMOOTH_S * recording.sample_rate_hz))
    step = math.pi / bins
    sense = 1.0 if psi[-1] > psi[0] else -1.0
    first = math.ceil(sense * psi[0] / step)
    edges = step * np.arange(first, first + bins + 1)
    if edges[-1] > sense * psi[-1]:
        raise DataError(f"Wave must turn by a bin more than a period of 4 theta, but turned by {np.ptp(psi):.3g} of {math.pi:.3g} rad.")
    when = np.interp(edges, sense * psi, recording.t)
    place = np.round(sense * (edges[:-1] + 0.5 * step) / step - 0.5).astype(int) % bins
    rate = np.empty(bins)
    rate[place] = sense * 0.5 * step / np.diff(when)
    return 360.0 * (np.arange(bins) + 0.5) / bins, rate


def worst(name: str, values: Any, unit: str, factor: float = 1.0, upper: float = math.inf) -> Gate:
    """The largest magnitude over the seeds."""
    return Gate(name, Quantity(factor * float(np.max(np.abs(values))), 0.0, unit), upper=upper)
