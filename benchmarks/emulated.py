"""What the diagnosis says of anybody's recordings whose rows are altered as an effect would alter them.

python benchmarks/emulated.py FILE [--unseen] [--snr 30 150] [--seed 1] [--only TEXT …] [--jobs 2]

Loops drop out of the equations of a gyro: what acted stands in the drive columns. So a healthy device's recordings become those of a device
with an effect by arithmetic alone. A pick-off that reads o besides: its columns plus o. A drive that makes d besides: its columns less d,
for what acted is what it was. A force that moves the wave by f: drives less ``G^-1 f``, which is what a controller would have held against
it. Noise, floors, plan and nuisances are those of the device, and the whole diagnosis begins anew. The effects are functions of the rows
(`emulated_effects.py`), not forms of the diagnosis; only how loud one is, is measured by the diagnosis' own noise.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
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
class Outcome:
    """What was said of one effect, and whether that is right."""

    effect: Emulated
    snr: float
    size: float
    right: bool
    said: str


@cache
def _healthy(path: Path) -> tuple[Campaign, CampaignModel]:
    campaign = load_campaign(path)
    return campaign, looked_at(campaign)


def judged(path: Path, name: str, snr: float, seed: int) -> Outcome | None:
    """Diagnose a file with one effect more; None where the nuisances hide it."""
    campaign, model = _healthy(path)
    effect = next(e for e in (*EMULATED, *UNSEEN) if e.name == name)
    z = np.random.default_rng([seed, *effect.name.encode()]).normal(size=4)
    size = size_of(model, effect, z, snr)
    if size is None:
        return None
    try:
        found = diagnose(altered(campaign, model, effect, z, size))
    except DataError as error:
        return Outcome(effect, snr, size, False, f"refused: {error}")
    return Outcome(effect, snr, size, _is_right(effect, found), _said(found))


def _is_right(effect: Emulated, found: Diagnosis) -> bool:
    if not effect.registry:
        return found.verdict == "unknown"
    return found.verdict == "effects" and len(found.effects) == 1 and bool(set(effect.registry) & set(found.effects[0].group))


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
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=[], help="effects whose name holds one of these")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    effects = UNSEEN if options.unseen else EMULATED
    names = [e.name for e in effects if not options.only or any(text in e.name for text in options.only)]
    tasks = [(options.file, name, snr, options.seed) for snr in options.snr for name in names]
    if options.jobs > 1:
        with ProcessPoolExecutor(options.jobs) as pool:
            outcomes = _told(pool.map(judged, *zip(*tasks, strict=True)))
    else:
        outcomes = _told(judged(*task) for task in tasks)
    for snr in options.snr:
        for kind, of in (("of the registry", True), ("strangers", False)):
            some = [o for o in outcomes if o.snr == snr and bool(o.effect.registry) == of]
            print(f"SNR {snr:g}, {kind}: {sum(o.right for o in some)} of {len(some)} right", flush=True)


def _told(outcomes: Iterable[Outcome | None]) -> list[Outcome]:
    found = []
    for o in outcomes:
        if o is not None:
            found.append(o)
            mark = "ok   " if o.right else "WRONG"
            print(f"{mark} SNR {o.snr:g}  {o.effect.name:36s} size {o.size:9.3g}  {o.said}", flush=True)
    return found


if __name__ == "__main__":
    main()
