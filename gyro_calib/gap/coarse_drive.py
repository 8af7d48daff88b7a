"""Coarse steps of the drives' converter: their grid read off samples at its rate, what they do asked of the slow flow.

Rounding to steps q adds a saw-tooth to a drive. Of a carrier of amplitude A, beside noise of s steps, its fundamental is the series
``2 sum_n (-1)^n q/(pi n) J1(2 pi n A/q) exp(-2 pi^2 n^2 s^2)`` (Widrow and Kollar, Quantization Noise, 2008, ch. 4): it changes its sign
with every step of the amplitude, and no force of a resonator does that. Beside noise of steps and more nothing of it is left but a white
noise, ``q^2/12`` a sample, which is told by the grid and by the noise that waves have.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv

from ..effects import EFFECTS
from ..quantity import Quantity
from ..recording.recording import Recording
from .columns import form_columns
from .converter_steps import ConverterSteps, converter_steps
from .diagnosis import FoundEffect, Standing
from .evidence import CHANNELS
from .model import CampaignModel
from .noise_law import WHITE
from .parts import Form, Linear, Part, Setting
from .screen import Candidate, Screened
from .signals import Signals
from .spectral_effects import SIGMA, SpectralEffects, found_beside
from .strangers import MARGIN

__all__ = ["FULL_SCALE_V", "NAME", "SHARE", "rounded", "with_coarse_drive", "with_steps"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
NAME = "drive_quantisation"
#: noise beside a drive, in steps: none that is known, for samples that do not slide over the cycle dither as well
_NOISE = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
#: share of what steps do that is theirs, at any of these
SHARE = (0.3, 2.0)
#: chi-square that such steps may have under any other name, over their own: between two rows the error goes on, which the form has not
_OTHERS = 3.0
#: part of the white noise of waves that rounding makes by q^2/12 a sample, at which it is most of it: samples that meet the same phases
#: cycle by cycle leave ten times as much near the carrier; of more, columns hold what the converter made. 0.13 and 0.74 of two plants'
#: coarse drives; of thirteen campaigns of ten plants 0.012 and less
_FLOOR = (0.05, 2.0)
#: full scale of a drive that no factory states [V]; finest steps over the range that a noise is blamed on: of fifteen bits. Of the noise of
#: a quiet ring of a 27th plant 0.27 is that of a converter of eighteen
FULL_SCALE_V, _COARSE = 5.0, 2.0**-15
#: terms of the series: those that noise of a twentieth of a step leaves
_TERMS = 40


def rounded(amplitude: FloatArray, step_v: float, noise_steps: float) -> FloatArray:
    """Fundamental of what rounding adds to a carrier [V], shape of ``amplitude``.

    Parameters
    ----------
    amplitude : ndarray
        Of the carrier [V].
    step_v : float
        Of the converter [V].
    noise_steps : float
        Standard deviation of the noise beside the carrier, in steps.
    """
    n = np.arange(1, _TERMS)
    size = 2.0 * (-1.0) ** n * step_v / (np.pi * n) * np.exp(-2.0 * (np.pi * n * noise_steps) ** 2)
    return np.asarray(sum(s * jv(1, 2.0 * np.pi * k * amplitude / step_v) for k, s in zip(n, size, strict=True)))


def with_coarse_drive(
    beside: SpectralEffects,
    model: CampaignModel,
    recordings: Sequence[Recording],
    left_out: Collection[str],
    full_scale_v: float = FULL_SCALE_V,
) -> SpectralEffects:
    """The findings beside the fit with the steps of the drives' converter, if samples show them and the flow, or its noise, what they do.

    Parameters
    ----------
    beside : SpectralEffects
    model : CampaignModel
    recordings : sequence of Recording
        Those without samples at the converters' rate say nothing.
    left_out : collection of str
        Effects that the registry does not hold.
    full_scale_v : float
        Of the converter, to either side [V].
    """
    steps = converter_steps(recordings, ("x_drive", "y_drive"))
    if steps is None or NAME in left_out:
        return beside
    found = _asked(model, steps)
    if found is not None:
        gain = found.gain
    elif steps.lsb_v > _COARSE * 2.0 * full_scale_v and _FLOOR[0] < _share_of_noise(model, recordings, steps.lsb_v) < _FLOOR[1]:
        gain = steps.rounded_gain if steps.undithered else SIGMA**2
    else:
        return replace(beside, standings=_with(beside.standings, {NAME: "excluded"}))
    return with_steps(beside, model.linear, (steps.lsb_v, steps.lsb_sd_v), gain)


def with_steps(beside: SpectralEffects, linear: Linear, lsb_v: tuple[float, float], gain: float) -> SpectralEffects:
    """The findings with steps of the drives, without the lines that those make.

    Parameters
    ----------
    beside : SpectralEffects
    linear : Linear
    lsb_v : tuple of float
        Size of a step and its sd [V].
    gain : float
        Chi-square that they take in the slow flow.
    """
    # what a rounded drive holds beside its fundamental shakes the resonator as a tone does
    kept = tuple(e for e in beside.effects if "external_tone" not in e.group or _driven_v(e, linear) > 0.5 * lsb_v[0])
    gone = [e for e in beside.effects if e not in kept]
    statuses = {name: "excluded" for e in gone for name in e.group} | {NAME: "present"}
    size = Quantity(*lsb_v, EFFECTS[NAME].parameter("lsb").unit)
    return replace(
        beside,
        effects=(*kept, found_beside(NAME, {"lsb": size}, gain, harmless=False)),
        standings=_with(beside.standings, statuses),
        products=max(beside.products, _OTHERS * gain),
        near=() if gone else beside.near,
    )


def _with(standings: Sequence[Standing], statuses: Mapping[str, str]) -> tuple[Standing, ...]:
    return tuple(replace(s, status=statuses.get(s.name, s.status)) for s in standings)


def _driven_v(line: FoundEffect, linear: Linear) -> float:
    """Amplitude of a tone on the drives [V], or of the drive that would make such a line of the pick-offs."""
    sizes = {name: abs(q.value) for name, q in line.parameters.items()}
    if line.name == "external_tone":
        return max(sizes["a_x"], sizes["a_y"])
    return 2.0 * math.pi * sizes["frequency_hz"] * max(sizes["v_x"], sizes["v_y"]) / float(np.abs(np.diag(linear.G)).min())


def _share_of_noise(model: CampaignModel, recordings: Sequence[Recording], lsb_v: float) -> float:
    """Which part of the white noise along and across waves rounding makes, as if it were white up to the converter's rate."""
    times = [np.asarray(r.raw["t"], dtype=np.float64) for r in recordings if r.raw and "t" in r.raw]
    keys = {r.noise_key(channel) for r in model.evidence if r.is_wave for channel in CHANNELS if channel != "frequency"}
    white = float(np.median([model.noise[key].coefficients[WHITE] for key in keys])) if keys else 0.0
    if not times or white <= 0.0:
        return 0.0
    sample_s = float(np.median(np.concatenate([np.diff(t) for t in times])))
    # one-sided 2 lsb^2/12 a sample over the rate, twice that in each part of a carrier, half of it on functions of unit norm
    return float(2.0 * np.abs(np.diag(model.linear.G)).max() ** 2 * lsb_v**2 / 12.0 * sample_s / white)


def _asked(model: CampaignModel, steps: ConverterSteps) -> Screened | None:
    """What the steps do in the slow flow, where it counts and is as large as they make it."""
    tried = [
        Candidate(NAME, {"noise": s}, tuple(form_columns(model.evidence, _form(steps.lsb_v, s), model.linear, {})), np.ones(1), len(_NOISE))
        for s in _NOISE
    ]
    shares = ((s, s.sizes()["share"][0]) for s in model.screener.screened(tried) if s.log_evidence > MARGIN)
    return max((s for s, share in shares if SHARE[0] < share < SHARE[1]), key=lambda s: s.gain, default=None)


def _form(step_v: float, noise_steps: float) -> Form:
    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        size = np.abs(s.drive)
        error: ComplexArray = rounded(size, step_v, noise_steps) * s.drive / np.maximum(size, math.ulp(1.0))
        return [Part("share", "drive", error)]

    return Form(parts)
