"""What an effect is: a name, a sentence, where it can be seen, and how it changes a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from environment import Scene
from unit import Unit

Shape = dict[str, float]
Apply = Callable[[Scene, float, Shape], None]
Draw = Callable[[np.random.Generator, Unit], Shape]


@dataclass(frozen=True)
class Effect:
    """An effect that a unit may have on top of what is healthy.

    Attributes
    ----------
    name : str
    what : str
        One sentence for the label.
    apply : callable
        ``apply(scene, size, shape)`` changes the scene.
    draw : callable
        ``draw(rng, unit)`` draws everything but the size.
    probe : callable
        ``probe(unit)`` is a size to begin the search of the severity with.
    registry : str or None
        The tool's name of it; None for a stranger.
    group : tuple of str
        Names that physics makes the same thing in such a campaign.
    needs : frozenset of str
        What the campaign must have: ``table``, ``thermal``, ``amplitudes``, ``sideband``.
    kinds : tuple of str
    power : float
        How the response grows with the size, for the first step of the search.
    """

    name: str
    what: str
    apply: Apply
    draw: Draw
    probe: Callable[[Unit], float]
    registry: str | None = None
    group: tuple[str, ...] = ()
    needs: frozenset[str] = frozenset()
    kinds: tuple[str, ...] = ("ring", "hrg")
    power: float = 1.0


def nothing(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw no shape at all."""
    return {}


def sign(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw a sign."""
    return {"sign": float(rng.choice([-1.0, 1.0]))}


def axis(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw a sign and an axis."""
    return {"sign": float(rng.choice([-1.0, 1.0])), "axis": float(rng.integers(0, 2))}


def axis_name(shape: Shape) -> str:
    """Axis of a shape as plant.c names it."""
    return "Y" if shape["axis"] else "X"


def plan_has(poor: str | None, kind: str) -> frozenset[str]:
    """What a campaign has, for `Effect.needs`."""
    has = {"table", "thermal", "amplitudes"} | ({"sideband"} if kind == "ring" else set())
    return frozenset(has - {{"no rate table": "table", "no temperature": "thermal", "one amplitude": "amplitudes"}.get(poor or "", "")})
