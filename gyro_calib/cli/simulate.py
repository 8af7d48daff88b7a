"""Simulate a device under a plan and write the recordings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import non_negative_int, print_table, progress_bar, say, spinner
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..device import Device
    from ..experiments import Plan, SimulatedInstrument
    from ..recording.recording import Campaign


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("device", metavar="DEVICE", help="device description: a YAML file, or the name of a packaged one (ring_15k)")
    parser.add_argument(
        "--plan",
        required=True,
        metavar="PLAN",
        help="self_calibrate, sideband, cubic, feedthrough, static, virtual_precession, scale_factor; bench: factory, pickoff_phase; "
        "to diagnose the gap: gap-ftr, gap-whole-angle",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=Path, metavar="DIR", help="directory for the recordings")
    what.add_argument("--steps", action="store_true", help="only print the plan, step by step")
    parser.add_argument(
        "--seed",
        type=non_negative_int,
        metavar="N",
        help="draw a unit of the design, its noise, the order of a gap campaign; without it the design itself",
    )
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        type=_effect,
        metavar="NAME.PARAM=VALUE",
        help="give the device an effect of the catalogue, e.g. duffing.k=0.5; once for each parameter",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        choices=("temperature", "applied_rate"),
        help="a gap campaign as on a bench without chamber (temperature) or rate table (applied_rate)",
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
    with spinner("loading"):
        import numpy as np

        from ..errors import DataError
        from ..experiments import SimulatedInstrument, plan_by_name, run_plan
        from ..recording.bag_writer import write_campaign_bag
        from ..recording.hdf5 import write_campaign_h5
        from ..simulation import GyroSimulator
        from ..units import DEG_H

    device = _device(arguments)
    plan = _plan(arguments, device)
    if arguments.steps:
        _print_steps(plan)
        return 0
    check_outputs(arguments, "out")
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
    with spinner("writing"):
        if arguments.format == "h5":
            write_campaign_h5(target, campaign)
        else:
            write_campaign_bag(target, campaign)
    say(f"{target}: {len(campaign)} recordings of {device.device_id}, {campaign.recordings[-1].t[-1]:.0f} s")
    return 0


def _effect(text: str) -> tuple[str, str, float]:
    """Argument type: ``NAME.PARAM=VALUE``."""
    key, equals, value = text.partition("=")
    name, dot, parameter = key.strip().partition(".")
    try:
        number = float(value)
    except ValueError:
        number = None
    if not (name and dot and parameter and equals) or number is None:
        raise argparse.ArgumentTypeError(f"must be NAME.PARAM=VALUE, such as duffing.k=0.5, but got {text!r}")
    return name, parameter, number


def _device(arguments: argparse.Namespace) -> Device:
    """The unit that is simulated, with the effects that were asked for besides its own."""
    from ..device import draw_unit, load_device

    device = load_device(arguments.device)
    if arguments.seed is not None:
        device = draw_unit(device, arguments.seed)
    if not arguments.effect:
        return device
    effects = {name: dict(sizes) for name, sizes in device.effects.items()}
    for name, parameter, value in arguments.effect:
        effects.setdefault(name, {})[parameter] = value
    return replace(device, effects=effects)


def _plan(arguments: argparse.Namespace, device: Device) -> Plan:
    """The plan, a gap campaign in an order drawn from the seed and from where the device stands."""
    from ..errors import DataError
    from ..experiments import GAP_PLANS, SimulatedInstrument, plan_by_name

    options: dict[str, Any] = {}
    if arguments.plan in GAP_PLANS:
        options = {
            "seed": arguments.seed or 0,
            "abilities": SimulatedInstrument.abilities - set(arguments.without),
            "temperature_degc": device.environment.temperature_degc,
        }
    elif arguments.without:
        raise DataError(f"--without must go with a plan of {', '.join(GAP_PLANS)}, but got {arguments.plan!r}. Leave it out.")
    plan = plan_by_name(arguments.plan, device.factory(), quality=arguments.quality, **options)
    for sentence in plan.left_out:
        say(sentence)
    return plan.with_compensation(tuple(arguments.compensation)) if arguments.compensation else plan


def _print_steps(plan: Plan) -> None:
    from ..report.plan_table import plan_table

    print_table(plan_table(plan))


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
