"""One fit three ways: side bands with derivatives of their own, with finite differences, and over all time instants. Same recordings, same
parameters, same start, same answer.

python benchmarks/estimators.py [--quick] [--json FILE]

The 15 parameters of document 000 from one noisy unit (carrier level, side bands on both axes); finite differences are scipy's least_squares
with its 2-point Jacobian on the very residuals. Beside them the estimator that gyro-calib calibrate uses, whose model is linear.
"""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
from common import Options, Outcome, cpu_seconds, main, ratio, spread
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.estimation.document_cost import Lines, cost_model, positions
from gyro_calib.estimation.document_fit import document_fit, rough_start
from gyro_calib.estimation.document_model import DocumentModel
from gyro_calib.estimation.levenberg import levenberg_marquardt
from gyro_calib.estimation.sideband_table import sideband_table
from gyro_calib.estimation.slow_flow_fit import fit_slow_flow
from gyro_calib.estimation.time_domain import time_domain_fit
from gyro_calib.experiments import SimulatedInstrument, run_plan
from gyro_calib.experiments.alternatives import alternative_plan
from gyro_calib.quantity import Quantity
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.study import Gate

_LINES_HZ = (0.1, 0.45, 0.8, 1.15, 1.5)
_RECORD_S = 20.0
#: start: damping and forcers 30 % off
_OFF = 1.3


def measure(options: Options) -> Outcome:
    """Times, ratios, and how far the answers differ."""
    device = draw_unit(load_device("ring_15k"), 1)
    recordings = _recordings(device)
    table = sideband_table(recordings)
    E = device.feedthrough.matrix()
    model = DocumentModel(table, fit_feedforward=False, feedforward=E)
    lines = Lines.of(model, with_carrier=False)
    residual = cost_model(model, lines, positions(lines))
    start = _OFF * rough_start(model, device.factory())

    def own() -> NDArray[np.float64]:
        return levenberg_marquardt(residual, start).parameters

    def differences() -> NDArray[np.float64]:
        scale = np.maximum(np.abs(start), 1e-3 * np.abs(start).max())
        tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
        return np.asarray(least_squares(lambda x: residual(x)[0], start, jac="2-point", x_scale=scale, **tight).x)

    instants = partial(time_domain_fit, recordings, start, feedforward=E)
    works = {
        "own derivatives": own,
        "finite differences": differences,
        "data table": partial(sideband_table, recordings),
        "slow-flow fit (gyro-calib calibrate)": partial(fit_slow_flow, recordings, 1.5),
    }
    times = cpu_seconds(works, 5 if options.quick else 31)
    times |= cpu_seconds({"time domain": instants}, 1 if options.quick else 5)
    each = {name: spread(1e3 * values, "ms") for name, values in times.items()}
    gates = [Gate(f"CPU time, {name}", value) for name, value in each.items()]
    gates.append(Gate("finite differences / own derivatives", ratio(each["finite differences"], each["own derivatives"]), lower=1.0))
    gates.append(Gate("time domain / own derivatives", ratio(each["time domain"], each["own derivatives"]), lower=100.0))
    whole = Quantity(each["data table"].value + each["own derivatives"].value, 0.0, "ms")
    gates.append(Gate("the same with the data table", ratio(each["time domain"], whole)))
    exact = document_fit(table, start, weights="equal", feedforward=E)
    sd = np.sqrt(np.diag(exact.covariance))
    gates.append(Gate("answers, finite differences - own, over sd", _apart(differences(), own(), sd), upper=0.01))
    late = instants()
    both = np.hypot(sd, np.sqrt(np.diag(late.covariance)))
    gates.append(Gate("answers, time domain - own, over sd of both, rms", _apart(late.values, own(), both, rms=True), upper=1.5))
    return Outcome(gates)


def _recordings(device: Device) -> list[Recording]:
    plan = alternative_plan("amplitude", device.factory(), lines_hz=_LINES_HZ, record_s=_RECORD_S)
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(1)), 1e-4)
    return [r for r in run_plan(instrument, plan) if r.command.excitation.kind == "amplitude_modulation"]


def _apart(found: NDArray[np.float64], other: NDArray[np.float64], sd: NDArray[np.float64], *, rms: bool = False) -> Quantity:
    over = (found - other) / sd
    return Quantity(float(np.sqrt(np.mean(over**2))) if rms else float(np.abs(over).max()), 0.0, "1")


if __name__ == "__main__":
    sys.exit(main("estimators", measure))
