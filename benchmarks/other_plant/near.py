"""What a label could be mistaken for, by physics alone: ``python near.py DIR`` writes DIR/labels_more without looking at any verdict.

Two effects that leave the same trace in a campaign are the same thing there. For each effect of a label the traces of the registry's
effects of the same family are computed on the same unit and plan; what is left of the label's trace after the best size of the other is
its distance from it, in units of the noise. Below 5 (the rule of gap.md), and below half its strength, the other name is accepted too; a
stranger that near to a registered effect is no fair stranger. It takes minutes for each campaign with an effect.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from effect import Effect, Shape, plan_has
from effects_known import KNOWN
from effects_strange import STRANGE
from kernel import Array
from make import SNR, stage
from severity import Ruler

FAMILIES = {
    "amplitude": (
        "duffing duffing_axes cubic_cross_stiffness cubic_cross_stiffness_axes drive_gap nonlinear_damping nonlinear_damping_axes "
        "quadratic_damping coulomb_friction "
        "drive_nonlinearity drive_amplitude_phase drive_dead_zone pickoff_nonlinearity pickoff_amplitude_phase pickoff_saturation "
        "drive_saturation"
    ),
    "temperature": (
        "thermal_damping_anisotropy thermal_split thermal_frequency_curvature thermal_drive_gain thermal_drive_phase thermal_pickoff_phase "
        "thermal_drive_gain_curvature thermal_pickoff_gain_curvature thermal_drive_coupling thermal_pickoff_coupling"
    ),
    "time": (
        "frequency_ageing split_drift damping_drift charge_accumulation drive_gain_drift drive_phase_drift pickoff_gain_drift "
        "pickoff_phase_drift drive_coupling_drift pickoff_coupling_drift"
    ),
    "rate": "centrifugal_stiffness angular_gain_error rate_nonlinearity rate_asymmetry",
    # a foreign line beside the carrier leaves one complex amplitude on each axis, whether it came in as a force or as a voltage
    "tone": "external_tone pickoff_interference",
}
STRANGE_FAMILY = {
    "intermittent_contact": "time",
    "relay_bounce": "time",
    "anchor_stick_slip": "time",
    "clock_hops": "time",
    "acoustic_resonance": "temperature",
    "thermal_hysteresis": "temperature",
    "outgassing": "temperature",
    "gradient_rate": "temperature",
    "heater_current": "temperature",
    "torsional_mount": "rate",
    "rate_hysteresis": "rate",
    "creeping_glue": "rate",
    "turning_front_end": "rate",
}
INSEPARABLE = 5.0


def _family(name: str) -> list[Effect]:
    family = STRANGE_FAMILY.get(name) or next((f for f, names in FAMILIES.items() if name in names.split()), "amplitude")
    return [e for e in KNOWN if e.name in FAMILIES[family].split()]


def _shapes(effect: Effect, unit_shape: Shape) -> list[Shape]:
    """Shapes whose traces span what an effect can be."""
    if "axis" in unit_shape:
        return [{**unit_shape, "sign": 1.0, "axis": a} for a in (0.0, 1.0)]
    if "c" in unit_shape:
        return [{**unit_shape, "c": 1.0, "s": 0.0}, {**unit_shape, "c": 0.0, "s": 1.0}]
    if "tau" in unit_shape:
        return [{**unit_shape, "tau": tau} for tau in (0.15, 0.3)]
    return [unit_shape]


def _distance(ruler: Ruler, trace: Array, other: Effect) -> float:
    shape = other.draw(np.random.default_rng(0), ruler.unit)
    size = other.probe(ruler.unit)
    if other.power != 1.0:
        wanted = max(float(np.linalg.norm(trace)), SNR[0])
        found = ruler.find(other, shape, wanted, (wanted / 2.0, 2.0 * wanted))
        size = found[0] if found else size
    traces = np.stack([ruler.trace(other, size, s) for s in _shapes(other, shape)], 1)
    q, _ = np.linalg.qr(traces)
    return float(np.linalg.norm(trace - q @ (q.T @ trace)))


def look(label: dict[str, Any], name: str) -> list[dict[str, object]]:
    """Distances of each effect of a label from its family."""
    by_name = {e.name: e for e in KNOWN + STRANGE}
    kind = str(label["kind"])
    unit, poor, steps, noise = stage(kind, np.random.default_rng(label["seed"]), name)
    out: list[dict[str, object]] = []
    if not label["effects"]:
        return out
    ruler = Ruler(unit, steps, noise)
    for entry in label["effects"]:
        shape = dict(entry["parameters"])
        size = shape.pop("size")
        effect = by_name[entry["name"]]
        trace = ruler.trace(effect, size, shape)
        snr = float(np.linalg.norm(trace))
        near: dict[str, float] = {}
        for other in _family(effect.name):
            if other.name == effect.name or not other.needs <= plan_has(poor, kind):
                continue
            if other.name in FAMILIES["tone"].split():
                near[other.name] = 0.0
            else:
                near[other.name] = round(_distance(ruler, trace, other), 2)
        same = [n for n, d in near.items() if d < min(INSEPARABLE, 0.5 * snr)]
        ordered = dict(sorted(near.items(), key=lambda item: item[1]))
        out.append({"name": effect.name, "snr_with_wander": round(snr, 2), "inseparable": same, "distances": ordered})
    return out


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="")
    args = parser.parse_args(argv)
    wanted = list(filter(None, args.only.split(",")))
    (args.folder / "labels_more").mkdir(exist_ok=True)
    names = wanted or sorted(p.stem for p in (args.folder / "labels").glob("*.json"))
    for name in names:
        label = json.loads((args.folder / "labels" / f"{name}.json").read_text())
        text = json.dumps(look(label, name), indent=1)
        target = args.folder / "labels_more" / f"{name}.json"
        target.with_suffix(".part").write_text(text)
        target.with_suffix(".part").replace(target)
        with (args.folder / "labels_more.sha256").open("a") as file:
            file.write(f"{hashlib.sha256(text.encode()).hexdigest()}  labels_more/{name}.json\n")
        print(name, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
