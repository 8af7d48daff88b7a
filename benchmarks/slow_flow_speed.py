"""Speed of the two simulators on one core, in device seconds per CPU second: slow flow 1000 or more, noise and temperature wander included.

python benchmarks/slow_flow_speed.py [--quick] [--json FILE]

The gate is on the fastest of the stretches: whatever else runs on the machine only ever slows one. The median is given beside it.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from common import Options, Outcome, cpu_seconds, main, spread

from gyro_calib.device import draw_unit, load_device
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.simulation import GyroSimulator
from gyro_calib.study import Gate

#: device time of one measurement [s]
STRETCH_S = {"slow_flow": 20.0, "carrier": 2.0}


def measure(options: Options) -> Outcome:
    """Both fidelities at rest, and the slow flow under side bands and noise-free."""
    device = draw_unit(load_device("ring_15k"), 1)

    def simulator(fidelity: str, noisy: bool = True) -> GyroSimulator:
        return GyroSimulator(device, rng=np.random.default_rng(1), fidelity=fidelity, noisy=noisy)

    side = simulator("slow_flow")
    side.configure(Command("ftr_x", Excitation("amplitude_modulation", 0.8, 0.15)))
    gyros = {
        "slow flow": simulator("slow_flow"),
        "slow flow, side bands": side,
        "slow flow, noise-free": simulator("slow_flow", False),
        "carrier": simulator("carrier"),
        "carrier, noise-free": simulator("carrier", False),
    }
    stretch = {name: STRETCH_S["slow_flow" if name.startswith("slow") else "carrier"] for name in gyros}

    def advance(name: str) -> object:
        return gyros[name].advance(stretch[name])

    times = cpu_seconds({name: lambda name=name: advance(name) for name in gyros}, 5 if options.quick else 25)
    gates = []
    for name, seconds in times.items():
        fastest = Quantity(stretch[name] / float(seconds.min()), 0.0, "x real time")
        gates.append(Gate(name, fastest, lower=1000.0 if name == "slow flow" else -math.inf))
        gates.append(Gate(f"{name}, median", spread(stretch[name] / seconds, "x real time")))
    return Outcome(gates)


if __name__ == "__main__":
    sys.exit(main("slow_flow_speed", measure))
