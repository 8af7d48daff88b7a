"""What the form of every effect leaves of a campaign without noise, weighed with the noise of one that has it: the model's own errors.

python benchmarks/noise_free.py --kind hemisphere [--seed 4242] [--unit 0] [--snr 24] [--jobs 2] [--only NAME …]

A line per effect: chi-square that the healthy device leaves, that the device with the effect leaves, degrees of freedom, and the largest
distance of a size from the truth in its standard deviations. The effect is given, not found. What multiplexed drives or levels make of an
effect is not in the ratio that sets its size: of those only what is left is to be read.
"""

from __future__ import annotations

import argparse
import functools
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from unittest import mock

import numpy as np

import gyro_calib.gap.model as gap_model
from gyro_calib.experiments import SimulatedInstrument, run_plan
from gyro_calib.gap.candidates import registry_name
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.relinearise import relinearised
from gyro_calib.gap.select import _refined
from gyro_calib.gap.system import NoiseByRole
from gyro_calib.simulation import GyroSimulator
from gyro_calib.trial.labels import reported_name, trial_effects
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import with_effects
from gyro_calib.trial.sizing import size_effect
from gyro_calib.trial.trial import _look, _reference
from gyro_calib.trial.units import Unit, draw_trial_unit

Sizes = dict[str, float]


def without_noise(unit: Unit, effects: dict[str, Sizes], noise: NoiseByRole) -> CampaignModel:
    """A quiet campaign of a unit with these effects, weighed with ``noise``."""
    quiet = replace(
        unit.device,
        environment=replace(unit.device.environment, wander_k=0.0),
        electronics=replace(unit.device.electronics, adc_bits=0, dac_bits=0),
    )
    simulator = GyroSimulator(with_effects(quiet, effects), rng=np.random.default_rng(0), fidelity="carrier", noisy=False)
    instrument = SimulatedInstrument(simulator, unit.rate_rad_s, sense_axis=unit.sense_axis)
    campaign = run_plan(instrument, campaign_plan(unit.kind, unit.device.factory(), np.random.default_rng(1), "standard"))
    with (
        mock.patch.object(gap_model, "measured_noise", return_value=(noise, {})),
        mock.patch.object(gap_model, "with_repeats", lambda evidence, columns, known, *_: known),
    ):
        return _look(campaign)


def weighed(unit: Unit, noise: NoiseByRole, job: tuple[str, Sizes]) -> str:
    """The line of one effect, or of none."""
    name, sizes = job
    model = without_noise(unit, {name: sizes} if name else {}, noise)
    if not name:
        return f"{'healthy':30s} {'':>12s} {model.screener.chi2:10.1f} {model.screener.dof:6d}"
    variants = [c for c in model.candidates[reported_name(name)] if registry_name(c.name, c.setting) == name]
    loudest = max(model.screener.screened(variants), key=lambda s: s.gain)
    (chosen,) = relinearised(model, [_refined(model, model.screener, loudest.candidate)])
    fit = model.fitted([chosen])
    # beside what a healthy device has of the same: the fit gives it all to the effect
    found = model.screener.screen(chosen)
    told = found.sizes() if found is not None else {}
    off = [abs(told[parameter][0] - size) / told[parameter][1] for parameter, size in sizes.items() if parameter in told]
    left = float(fit.residual @ fit.residual)
    return f"{name:30s} {model.screener.chi2:12.1f} {left:10.1f} {fit.residual.size:6d} {max(off, default=math.nan):8.1f}"


def main() -> None:
    """Every effect that a trial can hold in such a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=("ring", "hemisphere"), default="hemisphere")
    parser.add_argument("--seed", type=int, default=4242)
    parser.add_argument("--unit", type=int, default=0, help="number of the unit that the seed draws")
    parser.add_argument("--snr", type=float, default=24.0, help="effective signal-to-noise ratio that sets the sizes")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="+", metavar="NAME")
    options = parser.parse_args()
    unit = draw_trial_unit(options.kind, options.seed, options.unit)
    clean = _reference(options.kind, options.seed, options.unit, "standard")
    names = options.only or trial_effects(unit.mode)
    sized = {name: size_effect(clean, name, options.snr, np.random.default_rng(5)) for name in names}
    jobs = [("", {}), *((name, dict(s.sizes)) for name, s in sized.items() if s is not None)]
    print(f"{'effect':30s} {'healthy form':>12s} {'its form':>10s} {'of':>6s} {'off / sd':>8s}")
    with ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(functools.partial(weighed, unit, clean.noise), jobs):
            print(line, flush=True)
    print("no fair size:", ", ".join(name for name, s in sized.items() if s is None) or "none")


if __name__ == "__main__":
    main()
