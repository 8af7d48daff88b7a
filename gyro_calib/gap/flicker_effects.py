"""Gains and phases that flicker, as findings: sizes of the noise, not of the mean (measured by :mod:`.flickers`, :mod:`.phase_floors`)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from ..effects import EFFECTS
from ..quantity import Quantity
from .diagnosis import FoundEffect, Standing
from .drifts import walks_in
from .evidence import CampaignEvidence
from .flickers import DRIVE_FLICKERS, PICKOFF_FLICKERS, drive_flicker, pickoff_flicker, tells_drives
from .parts import Linear
from .phase_floors import PHASE_FLICKERS
from .screen import Candidate
from .spectral_effects import SpectralEffects, found_beside
from .system import NoiseByRole

__all__ = ["FLICKERS", "with_flickers", "without_walked"]

FLICKERS = ("pickoff_gain_flicker", "drive_gain_flicker", "pickoff_phase_flicker")
_PICKOFF, _DRIVE, _PHASE = FLICKERS
#: how well a floor is measured, over itself: 8e-5 and 5e-5 of pick-offs were 7.6e-5 and 4.7e-5, 3e-4 of drives 2.9e-4 and 3.2e-4; of phases
#: 6e-5 and 2e-5 were 5.8e-5 to 6.3e-5 and 1.8e-5 to 2.0e-5, and a filter of the rows may bend them
_SHARE_SD, _PHASE_SHARE_SD = 0.1, 0.15
#: chi-square of a finding that is as strong as it must be
_GAIN = 36.0
#: chi-square that loops which follow such a gain leave in the slow flow, at the least that counts; it goes with the power: 173 at 7.6e-5
#: of the pick-offs, 94 at 3e-4 of the drives
_LEFT = {_PICKOFF: 8.0, _DRIVE: 30.0, _PHASE: 0.0}
#: where each stands
_STANDS = {_PICKOFF: ("pick-off", "in phase"), _DRIVE: ("drive", "in phase"), _PHASE: ("pick-off", "in quadrature")}
#: what it may have been taken for
_ALIKE = {_PICKOFF: ("amplitude_noise",), _DRIVE: ("amplitude_noise",), _PHASE: ()}


def with_flickers(
    beside: SpectralEffects, evidence: CampaignEvidence, linear: Linear, noise: NoiseByRole, left_out: Iterable[str] = ()
) -> SpectralEffects:
    """What stands beside the slow flow, with gains and phases that flicker; noise in proportion to the wave is theirs where they do.

    Parameters
    ----------
    beside : SpectralEffects
    evidence : CampaignEvidence
    linear : Linear
    noise : mapping
        Laws by kind of recording and channel.
    left_out : iterable of str
        Effects that the registry shall not hold (blind trials).
    """
    phases = evidence.phase_floors
    sizes = {
        _PICKOFF: (pickoff_flicker(noise), PICKOFF_FLICKERS),
        _DRIVE: (drive_flicker(evidence, linear, noise), DRIVE_FLICKERS),
        _PHASE: ((math.sqrt(phases[0]), math.sqrt(phases[1])), PHASE_FLICKERS),
    }
    for name, (of_axes, least) in sizes.items():
        if name in set(left_out):
            continue
        told = name != _DRIVE or tells_drives(evidence)
        beside = replace(beside, standings=(*beside.standings, _standing(name, of_axes, least if told else None)))
        if any(of_axes):
            kept = tuple(e for e in beside.effects if e.name not in _ALIKE[name])
            standings = tuple(replace(s, status="excluded") if s.name in _ALIKE[name] else s for s in beside.standings)
            products = max(beside.products, _LEFT[name] * (max(of_axes) / least) ** 2)
            beside = replace(beside, effects=(*kept, _found(name, of_axes, least)), standings=standings, unknown=None, products=products)
    return beside


def without_walked(beside: SpectralEffects, chosen: Iterable[Candidate]) -> SpectralEffects:
    """Without the floors of what walks: a gain that walks moves within the records as well.

    Parameters
    ----------
    beside : SpectralEffects
    chosen : iterable of Candidate
        Effects of the slow flow.
    """
    walked = walks_in(chosen)
    dropped = {name for name in FLICKERS if _STANDS[name] in walked}
    standings = tuple(replace(s, status="excluded") if s.name in dropped else s for s in beside.standings)
    return replace(beside, effects=tuple(e for e in beside.effects if e.name not in dropped), standings=standings)


def _found(name: str, sizes: tuple[float, float], least: float) -> FoundEffect:
    share = _PHASE_SHARE_SD if name == _PHASE else _SHARE_SD
    names = [p.name for p in EFFECTS[name].parameters]
    unit = EFFECTS[name].parameters[0].unit
    parameters = {p: Quantity(size, share * max(size, least), unit) for p, size in zip(names, sizes, strict=True)}
    return found_beside(name, parameters, _GAIN, harmless=False)


def _standing(name: str, sizes: tuple[float, float], least: float | None) -> Standing:
    """``least``: what would have been seen, None where nothing would."""
    effect = EFFECTS[name]
    status = "present" if any(sizes) else "not testable" if least is None else "excluded"
    limit = Quantity(least, least, effect.parameters[0].unit) if status == "excluded" and least is not None else None
    return Standing(name, effect.title, effect.location, status, limit, 0.0, 0.0, 0.0)
