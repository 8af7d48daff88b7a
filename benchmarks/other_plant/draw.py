"""What a batch holds: strata in drawn order, and the effects of each campaign."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from effect import Effect, plan_has
from effects_known import KNOWN
from effects_strange import STRANGE
from plan import POOR

STRATA = {"healthy": 8, "single": 11, "stranger": 9, "pair": 4}


def draw_strata(count: int, rng: np.random.Generator) -> list[str]:
    """Strata of a batch in the shares of `STRATA`, in drawn order."""
    pool = [name for name, n in STRATA.items() for _ in range(n)]
    out: list[str] = []
    while len(out) < count:
        out += [pool[i] for i in rng.permutation(len(pool))]
    return out[:count]


def draw_poor(rng: np.random.Generator, kind: str) -> str | None:
    """One campaign in six lacks something."""
    return str(rng.choice(POOR)) if rng.uniform() < 1 / 6 else None


@dataclass
class Deck:
    """Deals effects without putting them back until all have been dealt."""

    rng: np.random.Generator
    dealt: set[str] = field(default_factory=set)

    def deal(self, strange: bool, kind: str, poor: str | None, besides: tuple[Effect, ...] = ()) -> Effect:
        """An effect that this kind may have and this plan could show."""
        has = plan_has(poor, kind)
        near = {name for e in besides for name in (e.registry, *e.group) if name}
        fit = [
            e
            for e in (STRANGE if strange else KNOWN)
            if kind in e.kinds and e.needs <= has and not near & {e.registry, *e.group} and e not in besides
        ]
        fresh = [e for e in fit if e.name not in self.dealt]
        if not fresh:
            self.dealt -= {e.name for e in fit}
            fresh = fit
        effect = fresh[int(self.rng.integers(len(fresh)))]
        self.dealt.add(effect.name)
        return effect
