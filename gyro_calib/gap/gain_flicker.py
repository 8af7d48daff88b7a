"""Gains that flicker, as a finding: a size of the noise, not of the mean (how it is measured: :mod:`.flickers`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from ..effects import EFFECTS
from ..quantity import Quantity
from .diagnosis import FoundEffect, Standing
from .evidence import CampaignEvidence
from .flickers import DRIVE_FLICKERS, PICKOFF_FLICKERS, drive_flicker, pickoff_flicker, tells_drives
from .parts import Linear
from .spectral_effects import SpectralEffects, found_beside
from .system import NoiseByRole

__all__ = ["with_gain_flicker"]

_PICKOFF, _DRIVE = "pickoff_gain_flicker", "drive_gain_flicker"
#: how well a floor is measured, over itself: 8e-5 and 5e-5 of pick-offs were 7.6e-5 and 4.7e-5, 3e-4 of drives 2.9e-4 and 3.2e-4
_SHARE_SD = 0.1
#: chi-square of a finding that is as strong as it must be
_GAIN = 36.0
#: chi-square that loops which follow such a gain leave in the slow flow, at the least that counts; it goes with the power: 173 at 7.6e-5
#: of the pick-offs, 94 at 3e-4 of the drives
_LEFT = {_PICKOFF: 8.0, _DRIVE: 30.0}


def with_gain_flicker(
    beside: SpectralEffects, evidence: CampaignEvidence, linear: Linear, noise: NoiseByRole, left_out: Iterable[str] = ()
) -> SpectralEffects:
    """What stands beside the slow flow, with gains that flicker; noise in proportion to the wave is theirs where they do.

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
    sizes = {_PICKOFF: (pickoff_flicker(noise), PICKOFF_FLICKERS), _DRIVE: (drive_flicker(evidence, linear, noise), DRIVE_FLICKERS)}
    for name, (of_axes, least) in sizes.items():
        if name in set(left_out):
            continue
        told = name == _PICKOFF or tells_drives(evidence)
        beside = replace(beside, standings=(*beside.standings, _standing(name, of_axes, least if told else None)))
        if any(of_axes):
            kept = tuple(e for e in beside.effects if e.name != "amplitude_noise")
            standings = tuple(replace(s, status="excluded") if s.name == "amplitude_noise" else s for s in beside.standings)
            products = max(beside.products, _LEFT[name] * (max(of_axes) / least) ** 2)
            beside = replace(beside, effects=(*kept, _found(name, of_axes, least)), standings=standings, unknown=None, products=products)
    return beside


def _found(name: str, sizes: tuple[float, float], least: float) -> FoundEffect:
    unit = EFFECTS[name].parameters[0].unit
    parameters = {f"g_{axis}": Quantity(g, _SHARE_SD * max(g, least), unit) for axis, g in zip("xy", sizes, strict=True)}
    return found_beside(name, parameters, _GAIN, harmless=False)


def _standing(name: str, sizes: tuple[float, float], least: float | None) -> Standing:
    """``least``: what would have been seen, None where nothing would."""
    effect = EFFECTS[name]
    status = "present" if any(sizes) else "not testable" if least is None else "excluded"
    limit = Quantity(least, least, effect.parameters[0].unit) if status == "excluded" and least is not None else None
    return Standing(name, effect.title, effect.location, status, limit, 0.0, 0.0, 0.0)
