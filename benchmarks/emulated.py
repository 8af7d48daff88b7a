"""What the diagnosis says of anybody's recordings whose rows are altered as an effect would alter them.

python benchmarks/emulated.py FILE [--unseen | --pairs 12] [--snr 30 150] [--seed 1] [--only TEXT …] [--jobs 2]

Loops drop out of the equations of a gyro: what acted stands in the drive columns. So a healthy device's recordings become those of a device
with an effect by arithmetic alone. A pick-off that reads o besides: its columns plus o. A drive that makes d besides: its columns less d,
for what acted is what it was. A force that moves the wave by f: drives less ``G^-1 f``, which is what a controller would have held against
it. Noise, floors, plan and nuisances are those of the device, and the whole diagnosis begins anew. The effects are functions of the rows
(`emulated_effects.py`), not forms of the diagnosis; only how loud one is, is measured by the diagnosis' own noise.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations, repeat
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from emulated_effects import EMULATED, UNSEEN, Emulated, FloatArray
from injected import looked_at

from gyro_calib.errors import DataError
from gyro_calib.gap.columns import part_columns
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.diagnosis import Diagnosis
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.parts import Part
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.signals import Signals
from gyro_calib.recording.load import load_campaign
from gyro_calib.recording.recording import Campaign, Recording

#: least share of an effect that the nuisances leave
_LEAST_LEFT = 0.02


class RowsOf:
    """Rows of signals as effects see them."""

    def __init__(self, s: Signals, E: np.ndarray) -> None:
        self.index, self.row_s, self.omega0_rad_s = s.index, s.row_s, s.omega0_rad_s
        self.pick, self.drive, self.motion = s.pick, s.drive, s.pick - s.drive @ E.T
        self.time_s, self.temperature_k, self.rate_rad_s, self.omega_rad_s = s.time_s, s.temperature_k, s.rate_rad_s, s.omega_rad_s
        self.is_closed = s.recording.command.mode != "loops_off"


def size_of(model: CampaignModel, effect: Emulated, z: FloatArray, snr: float) -> float | None:
    """What the effect is to be multiplied by for a chi-square of ``snr`` squared beside the nuisances; None where they hide it."""
    parts = [[Part("c", effect.kind, np.asarray(effect.signal(RowsOf(r.signals, model.linear.E), z)))] for r in model.evidence]
    clean, norms = model.screener.projected(part_columns(model.evidence, parts, model.linear))
    left = float(np.linalg.norm(clean))
    return snr / left if left > _LEAST_LEFT * float(norms[0]) else None


def altered(campaign: Campaign, model: CampaignModel, effect: Emulated, z: FloatArray, size: float) -> Campaign:
    """The campaign of a device that has the effect."""
    known = {id(r): e.signals for r, e in zip(usable(campaign), model.evidence, strict=True)}
    return replace(campaign, recordings=tuple(_altered(r, known[id(r)], model, effect, z, size) if id(r) in known else r for r in campaign))


def _altered(r: Recording, s: Signals, model: CampaignModel, effect: Emulated, z: FloatArray, size: float) -> Recording:
    added = size * np.asarray(effect.signal(RowsOf(replace(s, width=1), model.linear.E), z))
    if effect.kind == "flow":
        added = added @ np.linalg.inv(model.linear.G).T
    sign, first = (1.0, 2) if effect.kind == "output" else (-1.0, 6)
    data = r.data.copy()
    data[:, first : first + 4 : 2] += sign * added.real
    data[:, first + 1 : first + 5 : 2] += sign * added.imag
    return replace(r, data=data)


@dataclass(frozen=True)
class Task:
    """Effects that a device shall have, each as loud as is asked."""

    names: tuple[str, ...]
    snrs: tuple[float, ...]

    @property
    def kind(self) -> str:
        """What it is counted among."""
        if len(self.names) > 1:
            return "pairs"
        return f"SNR {self.snrs[0]:g}, {'of the registry' if _effect(self.names[0]).registry else 'strangers'}"

    def __str__(self) -> str:
        return " + ".join(f"{name} ({snr:g})" for name, snr in zip(self.names, self.snrs, strict=True))


@dataclass(frozen=True)
class Outcome:
    """What was said of it, and whether that is right."""

    task: Task
    sizes: tuple[float, ...]
    right: bool
    said: str


@cache
def _healthy(path: Path) -> tuple[Campaign, CampaignModel]:
    campaign = load_campaign(path)
    return campaign, looked_at(campaign)


def _effect(name: str) -> Emulated:
    return next(e for e in (*EMULATED, *UNSEEN) if e.name == name)


def judged(path: Path, task: Task, seed: int) -> Outcome | None:
    """Diagnose a file with these effects more; None where the nuisances hide one."""
    campaign, model = _healthy(path)
    sizes = []
    for name, snr in zip(task.names, task.snrs, strict=True):
        effect, z = _effect(name), np.random.default_rng([seed, *name.encode()]).normal(size=4)
        size = size_of(model, effect, z, snr)
        if size is None:
            return None
        campaign = altered(campaign, model, effect, z, size)
        sizes.append(size)
    try:
        found = diagnose(campaign)
    except DataError as error:
        return Outcome(task, tuple(sizes), False, f"refused: {error}")
    return Outcome(task, tuple(sizes), _is_right(task, found), _said(found))


def _is_right(task: Task, found: Diagnosis) -> bool:
    named = [set(_effect(name).registry) for name in task.names]
    if not all(named):
        return found.verdict == "unknown"
    groups = [set(e.group) for e in found.effects]
    matching = (all(a & b for a, b in zip(named, order, strict=True)) for order in permutations(groups))
    return found.verdict == "effects" and len(groups) == len(named) and any(matching)


def drawn_pairs(count: int, snrs: Sequence[float], seed: int) -> list[Task]:
    """Pairs of effects of the registry that no name has in common."""
    rng, known = np.random.default_rng([seed, 2]), [e for e in EMULATED if e.registry]
    found: list[Task] = []
    while len(found) < count:
        a, b = (known[k] for k in rng.choice(len(known), 2, replace=False))
        if not set(a.registry) & set(b.registry):
            found.append(Task((a.name, b.name), tuple(float(x) for x in rng.choice(np.asarray(snrs), 2))))
    return found


def _said(found: Diagnosis) -> str:
    names = [e.name for e in found.effects]
    if found.unknown is not None:
        names.append(f"[{found.unknown.words()}; near {found.unknown.nearest}]")
    return f"{', '.join(names) or found.verdict}; chi2 {found.chi2_before:.0f} -> {found.chi2_after:.0f} of {found.dof}"


def main() -> None:
    """A line for every effect, and the shares of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--snr", nargs="+", type=float, default=[100.0])
    parser.add_argument("--unseen", action="store_true", help="effects that were drawn up after the diagnosis")
    parser.add_argument("--pairs", type=int, default=0, help="so many pairs of effects of the registry instead, of these ratios")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=[], help="effects whose name holds one of these")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    effects = UNSEEN if options.unseen else EMULATED
    names = [e.name for e in effects if not options.only or any(text in e.name for text in options.only)]
    tasks = [Task((name,), (snr,)) for snr in options.snr for name in names]
    if options.pairs:
        tasks = drawn_pairs(options.pairs, options.snr, options.seed)
    if options.jobs > 1:
        with ProcessPoolExecutor(options.jobs) as pool:
            outcomes = _told(pool.map(judged, repeat(options.file), tasks, repeat(options.seed)))
    else:
        outcomes = _told(judged(options.file, task, options.seed) for task in tasks)
    for kind in dict.fromkeys(o.task.kind for o in outcomes):
        some = [o for o in outcomes if o.task.kind == kind]
        print(f"{kind}: {sum(o.right for o in some)} of {len(some)} right", flush=True)


def _told(outcomes: Iterable[Outcome | None]) -> list[Outcome]:
    found = []
    for o in outcomes:
        if o is not None:
            found.append(o)
            sizes = ", ".join(f"{size:.3g}" for size in o.sizes)
            print(f"{'ok   ' if o.right else 'WRONG'} {o.task!s:42} size {sizes:>9}  {o.said}", flush=True)
    return found


if __name__ == "__main__":
    main()
