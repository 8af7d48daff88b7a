"""How often an effect is found and named in one step if nothing but white noise stands in the way.

python benchmarks/identifiable.py [--kind ring hemisphere] [--snr 8 12] [--draws 20] [--noise 0] [--units 1] [--seed 4242] [--jobs 2]

Each effect at a size that `gyro-calib blind-trial` would draw, in its own linear form, beside the nuisances of a clean campaign whose noise
is taken as known; what is drawn again and again is the white noise and the nuisances' own sizes. An effect is found when its evidence on
the grid of its settings, or between them, counts, and right when the group of the best name holds it. Left out is what a real campaign
adds (noise that must be measured, floors whose size must be, what the linear form leaves) and what the diagnosis does besides: pairs when
none shows alone, a name where an unnamed term would be taken. So it is a reference, no bound.
"""

from __future__ import annotations

import argparse
import copy
import functools
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np

from gyro_calib.gap.screen import Screened, Screener
from gyro_calib.gap.select import _between_settings, _enough, as_good, best_of_each
from gyro_calib.trial.labels import reported_name, trial_effects
from gyro_calib.trial.sizing import Sized, imitators, size_effect
from gyro_calib.trial.trial import LIKE, _reference
from gyro_calib.trial.units import draw_trial_unit


def drawn(screener: Screener, signal: np.ndarray, rng: np.random.Generator) -> Screener:
    """The same equations with a signal and noise of their own: the nuisances' rows of their priors hold their sizes."""
    again = copy.copy(screener)
    noise = rng.standard_normal(signal.size)
    again.left = signal + noise - screener.imitated(noise)
    return again


def named(ranked: list[Screened], names: set[str]) -> bool:
    """Whether the group of the best holds one of these names."""
    return any(s.name in names and as_good(s, ranked[0]) for s in ranked)


def shares(draws: int, job: tuple[str, int, int, str, float]) -> tuple[str, str, float, int, int]:
    """Of how many draws of an effect it is found, and right."""
    kind, seed, number, name, snr = job
    model, rng = _reference(kind, seed, number, "standard"), np.random.default_rng([seed, number, round(snr)])
    sized: Sized | None = size_effect(model, name, snr, rng)
    if sized is None:
        return kind, name, snr, -1, 0
    # as in a blind trial: what no campaign tells from the truth is right, too
    names = {reported_name(name), *(other for other, left in imitators(model, sized).items() if left < LIKE)}
    found = right = 0
    for _ in range(draws):
        noisy = replace(model, screener=drawn(model.screener, sized.signal, rng))
        ranked = best_of_each(noisy.screener, model.candidates)
        if ranked and not _enough(ranked[0]):
            ranked = _between_settings(noisy, ranked)
        if ranked and _enough(ranked[0]):
            found += 1
            right += named(ranked, names)
    return kind, name, snr, found, right


def in_noise_alone(kind: str, seed: int, number: int, draws: int) -> np.ndarray:
    """Largest log evidence of any effect in each draw of noise alone, shape (draws,); -inf where none explains anything."""
    model, rng = _reference(kind, seed, number, "standard"), np.random.default_rng([seed, number])
    nothing = np.zeros_like(model.screener.left)
    found = (best_of_each(drawn(model.screener, nothing, rng), model.candidates) for _ in range(draws))
    return np.array([ranked[0].log_evidence if ranked else -np.inf for ranked in found])


def main() -> None:
    """A line for every effect that falls short, and the shares of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", nargs="+", choices=("ring", "hemisphere"), default=["ring", "hemisphere"])
    parser.add_argument("--snr", nargs="+", type=float, default=[8.0, 12.0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--noise", type=int, default=0, help="draws of noise alone: what log evidence none reaches by chance")
    parser.add_argument("--units", type=int, default=1)
    parser.add_argument("--seed", type=int, default=4242)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    jobs = [
        (kind, options.seed, number, name, snr)
        for kind in options.kind
        for number in range(options.units)
        for name in trial_effects(draw_trial_unit(kind, options.seed, number).mode)
        for snr in options.snr
    ]
    total: dict[tuple[str, float], list[tuple[int, int]]] = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        for kind, name, snr, found, right in pool.map(functools.partial(shares, options.draws), jobs, chunksize=8):
            if found < 0:
                continue
            total.setdefault((kind, snr), []).append((found, right))
            if right < 0.95 * options.draws:
                print(
                    f"{kind:10s} {name:30s} SNR {snr:4.0f}  found {found / options.draws:.2f}  named right {right / options.draws:.2f}",
                    flush=True,
                )
    for kind in options.kind if options.noise else ():
        largest = np.quantile(in_noise_alone(kind, options.seed, 0, options.noise), [0.5, 0.9, 0.99])
        print(
            f"{kind:10s} noise alone, {options.noise} draws: largest log evidence 50, 90, 99 %: " + ", ".join(f"{q:.1f}" for q in largest)
        )
    for (kind, snr), counts in sorted(total.items()):
        found, right = np.sum(counts, axis=0) / (len(counts) * options.draws)
        print(f"{kind:10s} all {len(counts)} effects, SNR {snr:4.0f}: found {found:.3f}, named right {right:.3f}")


if __name__ == "__main__":
    main()
