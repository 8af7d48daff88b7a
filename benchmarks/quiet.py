"""What the diagnosis says of healthy units whose resonance does not wander: what is wrong by a millionth shows there, and nowhere else.

python benchmarks/quiet.py [--kind hemisphere ring] [--seed 501 502] [--noise 1.0]

Millikelvins move the frequency of a hemisphere by 1e-4 rad/s and hide what its equations lack; without them it is told to 1e-7 rad/s. A
unit is drawn as for blind trials, its wander taken away, the noise of its electronics multiplied, and a whole campaign is recorded at
carrier level. Every verdict but *none* is an error of the model, and its size says which.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from gyro_calib.gap.diagnose import diagnose
from gyro_calib.recording.recording import Campaign
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import Unit, draw_trial_unit

#: noise of the thermometer: it follows a temperature that stands still
_SENSOR = 0.1


def stilled(unit: Unit, noise: float) -> Unit:
    """The unit without a wander, its electronics quieter by a factor."""
    device = unit.device
    quieter = replace(
        device.noise,
        pickoff_v_rthz=noise * device.noise.pickoff_v_rthz,
        drive_v_rthz=noise * device.noise.drive_v_rthz,
        drive_flicker_v=noise * device.noise.drive_flicker_v,
    )
    still = replace(device, noise=quieter, environment=replace(device.environment, wander_k=0.0))
    return replace(unit, device=still, sensor_noise_k=_SENSOR * unit.sensor_noise_k, sensor_drift_k=_SENSOR * unit.sensor_drift_k)


def recorded(kind: str, seed: int, noise: float) -> Campaign:
    """Its whole campaign."""
    unit, rng = stilled(draw_trial_unit(kind, seed, 1), noise), np.random.default_rng(seed + 5)
    return record_unit(unit, campaign_plan(kind, unit.device.factory(), rng), {}, rng)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", nargs="+", choices=("ring", "hemisphere"), default=["hemisphere", "ring"])
    parser.add_argument("--seed", nargs="+", type=int, default=[501])
    parser.add_argument("--noise", type=float, default=1.0, help="factor of the electronics' noise")
    args = parser.parse_args()
    for kind in args.kind:
        for seed in args.seed:
            found = diagnose(recorded(kind, seed, args.noise))
            print(f"{kind} {seed}: {found.verdict}. {found.summary}", flush=True)


if __name__ == "__main__":
    main()
