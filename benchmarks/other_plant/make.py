"""Make a batch of campaigns with sealed labels: ``python make.py --seed 7 --campaigns 32 --out DIR``."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from campaign import Recording, run
from draw import Deck, draw_poor, draw_strata
from effect import Effect, Shape
from environment import Scene
from plan import Step, draw_plan
from severity import HOW, Ruler
from unit import Unit, draw_unit
from write import write_campaign, write_label

Found = tuple[Effect, float, Shape, float]
#: how strong effects are
SNR = (8.0, 40.0)


def _together(found: list[Found]) -> Callable[[Scene], None]:
    def apply(scene: Scene) -> None:
        for effect, size, shape, _ in found:
            effect.apply(scene, size, shape)

    return apply


def _sane(recordings: list[Recording]) -> bool:
    """A logger looks at its loops: amplitudes where they were set, no converter at its end, nothing undefined."""
    for recording in recordings:
        c, step = recording.columns, recording.step
        if not all(np.all(np.isfinite(x)) for x in c.values()):
            return False
        drive = max(float(np.max(np.hypot(c[f"{a}_drive_c"], c[f"{a}_drive_s"]))) for a in "xy")
        pick = np.sqrt(sum(c[f"{a}_pick_{b}"] ** 2 for a in "xy" for b in "cs"))
        if drive > 4.95 or float(pick.max()) > 2.2:
            return False
        # on the table the wave runs ahead of its loops for a moment
        if step.mode in ("ftr_x", "ftr_y", "whole_angle") and abs(float(pick.mean()) / step.amplitude - 1.0) > 0.02:
            return False
    return True


def _label(kind: str, stratum: str, found: list[Found], seed: list[int], poor: str | None) -> dict[str, object]:
    effects = [
        {
            "name": e.name,
            "registry": e.registry,
            "group": list(e.group),
            "parameters": {"size": size, **shape},
            "snr": round(snr, 2),
            "what": e.what,
        }
        for e, size, shape, snr in found
    ]
    label: dict[str, object] = {"kind": kind, "stratum": stratum, "effects": effects, "seed": seed, "poor": poor}
    if effects:
        label["snr_how"] = HOW
    return label


def stage(kind: str, rng: np.random.Generator, name: str) -> tuple[Unit, str | None, list[Step], int]:
    """Draw all of a campaign but its effects: unit, what the logger lacks, plan, seed of the noise."""
    unit = draw_unit(kind, rng, name)
    poor = draw_poor(rng, kind)
    return unit, poor, draw_plan(kind, rng, poor), int(rng.integers(1, 2**31))


def make_one(
    number: int, kind: str, stratum: str, seed: int, deck: Deck, out: Path, wander: bool = True, snr: tuple[float, float] = SNR
) -> None:
    """Draw, measure, run and write one campaign."""
    key = [seed, number]
    rng = np.random.default_rng(key)
    name = f"c{number:02d}"
    unit, poor, steps, noise = stage(kind, rng, f"{kind}-{seed}{number:02d}")
    found: list[Found] = []
    if stratum != "healthy":
        ruler = Ruler(unit, steps, noise, wander)
        while len(found) < (2 if stratum == "pair" else 1):
            effect = deck.deal(stratum == "stranger", kind, poor, tuple(f[0] for f in found))
            shape = effect.draw(rng, unit)
            wanted = math.exp(rng.uniform(math.log(snr[0]), math.log(snr[1])))
            answer = ruler.find(effect, shape, wanted, snr)
            if answer is None:
                deck.dealt.discard(effect.name)
                continue
            trial = [*found, (effect, answer[0], shape, answer[1])]
            if not _sane(run(unit, steps, noise, _together(trial), noise=False)):
                continue
            found = trial
    # other noise than the one the strength was measured with
    recordings = run(unit, steps, noise + 1, _together(found))
    if not _sane(recordings):
        print(f"{name}: a logger would have noticed something; written all the same", flush=True)
    digest = write_label(out, name, _label(kind, stratum, found, key, poor))
    write_campaign(out / "data" / f"{name}.h5", unit, recordings)
    print(f"{name} {digest}", flush=True)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--campaigns", type=int, default=32)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kinds", default="ring,hrg", help="kinds of gyro, taken in turn")
    parser.add_argument(
        "--fast-noise-only", action="store_true", help="leave the 1/f of gains out of the strength, as in the first batch of seed 7"
    )
    parser.add_argument("--snr", type=float, nargs=2, default=SNR, metavar=("LEAST", "MOST"), help="strength of the effects")
    args = parser.parse_args(argv)
    kinds = args.kinds.split(",")
    rng = np.random.default_rng(args.seed)
    strata = draw_strata(args.campaigns, rng)
    deck = Deck(rng)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "labels.sha256").unlink(missing_ok=True)
    for number, stratum in enumerate(strata, 1):
        start = time.monotonic()
        make_one(number, kinds[(number - 1) % len(kinds)], stratum, args.seed, deck, args.out, not args.fast_noise_only, tuple(args.snr))
        print(f"  {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
