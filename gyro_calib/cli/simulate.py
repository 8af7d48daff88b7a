"""Simulate a device under a plan and write the recordings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from .console import non_negative_int, progress_bar, say

if TYPE_CHECKING:
    from ..experiments import Plan, SimulatedInstrument
    from ..recording.recording import Campaign


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("device", metavar="DEVICE", help="device description: a YAML file, or the name of a packaged one (ring_15k)")
    parser.add_argument(
        "--plan",
        required=True,
        metavar="PLAN",
        help="self_calibrate, sideband, cubic, feedthrough, static, virtual_precession, scale_factor; bench: factory, pickoff_phase",
    )
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="directory for the recordings")
    parser.add_argument(
        "--seed", type=non_negative_int, metavar="N", help="draw a unit of the design and its noise; without it the design itself"
    )
    parser.add_argument("--rate", type=float, default=0.0, metavar="DEG_H", help="constant input rate [deg/h]")
    parser.add_argument("--quality", choices=("quick", "standard", "fine"), default="standard", help="duration of the plan")
    parser.add_argument("--fidelity", choices=("carrier", "slow_flow"), default="carrier", help="every converter sample, or averaged")
    matrix = parser.add_mutually_exclusive_group()
    matrix.add_argument("--compensation", nargs=4, type=float, metavar="C", help="drive compensation in force, row-major (1 0 0 1: none)")
    matrix.add_argument(
        "--compensate", action="store_true", help="whole angle: identify, compensate, identify again, until the residual is noise"
    )
    parser.add_argument("--format", choices=("h5", "mcap"), default="h5", help="one HDF5 file, or a ROS 2 bag")


def run(arguments: argparse.Namespace) -> int:
    """Simulate and write ``<device>_<plan>.h5`` or a bag of that name."""
    import numpy as np

    from ..device import draw_unit, load_device
    from ..errors import DataError
    from ..experiments import SimulatedInstrument, plan_by_name, run_plan
    from ..recording.bag_writer import write_campaign_bag
    from ..recording.hdf5 import write_campaign_h5
    from ..simulation import GyroSimulator
    from ..units import DEG_H

    device = load_device(arguments.device)
    if arguments.seed is not None:
        device = draw_unit(device, arguments.seed)
    plan = plan_by_name(arguments.plan, device.factory(), quality=arguments.quality)
    if arguments.compensation:
        plan = plan.with_compensation(tuple(arguments.compensation))
    stem = f"{device.device_id}_{plan.name}"
    target = arguments.out / (f"{stem}.h5" if arguments.format == "h5" else stem)
    if target.exists():
        raise DataError(f"Recording must be new, but got {target}, which exists. Choose another directory, or remove it.")
    arguments.out.mkdir(parents=True, exist_ok=True)
    simulator = GyroSimulator(device, rng=np.random.default_rng(arguments.seed), fidelity=arguments.fidelity)
    with progress_bar("simulating") as report:
        instrument = SimulatedInstrument(simulator, arguments.rate * DEG_H)
        if arguments.compensate:
            campaign = _compensated(
                instrument, plan, plan_by_name("virtual_precession", device.factory(), quality=arguments.quality), report
            )
        else:
            campaign = run_plan(instrument, plan, on_progress=lambda p: report(p.fraction, p.step_label))
    if arguments.format == "h5":
        write_campaign_h5(target, campaign)
    else:
        write_campaign_bag(target, campaign)
    say(f"{target}: {len(campaign)} recordings of {device.device_id}, {campaign.recordings[-1].t[-1]:.0f} s")
    return 0


def _compensated(instrument: SimulatedInstrument, plan: Plan, verify: Plan, report: Callable[[float, str], None]) -> Campaign:
    """All rounds of :func:`gyro_calib.calibration.compensate`, each told on a line."""
    from ..calibration import compensate
    from ..errors import DataError

    if plan.final.mode != "whole_angle" or not any(step.command.setpoints.virtual_precession_v for step in plan.steps):
        raise DataError(
            f"Plan to compensate with must have virtual precession, but got {plan.name!r} of a gyro in {plan.final.mode}. "
            "Give a whole-angle device and --plan virtual_precession or self_calibrate."
        )
    found = compensate(
        instrument,
        plan,
        verify,
        on_progress=lambda leg, p: report(leg.fraction(p.fraction), f"round {leg.number}: {p.step_label}"),
        on_round=lambda done: say(str(done)),
    )
    return found.campaign
