"""One look at a campaign: projected, its noise measured, its nuisances fitted, ready to be screened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..recording.recording import Recording
from .anonymous import Anonymous, anonymous_candidates
from .candidates import candidate_at, candidates_of
from .columns import Column
from .evidence import CampaignEvidence
from .linear_device import TEMPERATURE_SPAN_K, frequency_columns, linear_columns, linear_of, span_k, target_of
from .noise import first_noise, measured_noise
from .nuisance import SWITCHED, slow_columns, thermal_columns, wander_columns, with_wander
from .parts import Linear, Setting
from .preflight import check_linear
from .screen import Candidate, Screener
from .slow import measured_drifts, slow_drifts, with_drifts
from .system import NoiseByRole, Solution, Whitener, solve

__all__ = ["CampaignModel", "look_at"]

ComplexArray = NDArray[np.complex128]
#: resonance wander between records before it is known, over its frequency; least and most that are believed, over that
_WANDER, _LEAST_WANDER, _MOST_WANDER = 5e-8, 0.3, 10.0
#: of the settings of a gridded effect, how many the saturated model holds
_SATURATED_SETTINGS = 4
#: columns of the saturated model over equations, at most
_SATURATION = 0.5

#: what an unnamed term that depends on something needs
_NEEDED = {"speed of change": "open drive", "temperature": "temperature"}

#: of a drive and of a pick-off: opposite to each other they are one filter of both
_TWIN = {"pickoff_memory": "drive_memory", "pickoff_lag": "drive_lag"}
#: effects with a memory, or that feed through
_FAST = (
    "drive_lag",
    "drive_memory",
    "pickoff_lag",
    "pickoff_memory",
    "channel_skew",
    "relaxation",
    "spurious_mode",
    "thermal_feedthrough",
    "parametric_pump",
)


@dataclass(frozen=True)
class CampaignModel:
    """A campaign with its base fit.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    noise : mapping
    whitener : Whitener
    nuisances : tuple of Column
    candidates : mapping
        Effects of the registry, by name.
    bank : sequence of (Anonymous, Candidate)
        Terms without a name.
    screener : Screener
        Against the nuisances alone.
    base : Solution
    """

    evidence: CampaignEvidence
    linear: Linear
    noise: NoiseByRole
    whitener: Whitener
    nuisances: tuple[Column, ...]
    candidates: Mapping[str, Sequence[Candidate]]
    bank: Sequence[tuple[Anonymous, Candidate]]
    screener: Screener
    base: Solution

    def candidate(self, name: str, setting: Setting) -> Candidate:
        """An effect at another setting than those of its grid."""
        return candidate_at(self.evidence, self.linear, name, setting, len(self.candidates[name]))

    @property
    def target(self) -> list[ComplexArray]:
        """Left-hand sides by recording: what the slow flow with the factory's response to rate must explain."""
        return target_of(self.evidence, self.linear.angular_gain)

    def fitted(self, candidates: Sequence[Candidate]) -> Solution:
        """The nuisances and these effects together; of what is both, the effect is all of it."""
        names = {c.name for c in candidates}
        columns = [*(c for c in self.nuisances if c.name.split(".")[0] not in names), *effect_columns(candidates)]
        return solve(columns, self.whitener.design(columns, len(self.evidence)), self.whitener.rows(self.target))

    def screener_with(self, candidates: Sequence[Candidate]) -> Screener:
        """Screens what these effects leave."""
        return Screener(self.whitener, [*self.nuisances, *effect_columns(candidates)], self.target) if candidates else self.screener


def effect_columns(candidates: Sequence[Candidate]) -> list[Column]:
    """Columns of effects, named ``effect.parameter``, with the prior of their size."""
    return [
        Column(f"{c.name}.{column.name}", column.signal, column.quiet, float(sd))
        for c in candidates
        for column, sd in zip(c.columns, c.prior_sd, strict=True)
    ]


def look_at(
    recordings: Sequence[Recording],
    decay_rate: float,
    angular_gain: float,
    *,
    without: Iterable[str] = (),
    on_progress: Callable[[float, str], None] | None = None,
) -> CampaignModel:
    """Project a campaign, measure its noise with everything allowed for, fit the nuisances.

    Parameters
    ----------
    recordings : sequence of Recording
    decay_rate : float
        Rough 1/tau [1/s].
    angular_gain : float
        kappa of the factory.
    without : iterable of str
        Effects that the registry shall not hold.
    on_progress : callable, optional
        (fraction, what is done).
    """
    report = on_progress or (lambda fraction, text: None)
    report(0.0, "projecting")
    evidence = CampaignEvidence.of(recordings, decay_rate)
    report(0.25, "fitting the linear device")
    wander = _WANDER * evidence.omega0_rad_s
    start = [*linear_columns(evidence, rate_known=False), *frequency_columns(evidence), *wander_columns(evidence, wander)]
    linear, rough = _linear(evidence, start, angular_gain, 0.0)
    check_linear(linear, rough, recordings)
    # what feeds through does not resonate: once E is known the frequency's column is right
    linear, _ = _linear(evidence, _nuisances(evidence, linear, wander), angular_gain, angular_gain)
    linear = _resonant(evidence, _nuisances(evidence, linear, _MOST_WANDER * wander), angular_gain)
    report(0.35, "effects of the registry")
    nuisances = _nuisances(evidence, linear, wander)
    candidates = candidates_of(evidence, linear, without, lambda f: report(0.35 + 0.4 * f, "effects of the registry"))
    missing = _missing(evidence)
    candidates = {name: tried for name, tried in candidates.items() if not missing & set(EFFECTS[name].needs)}
    bank = [(term, c) for term, c in anonymous_candidates(evidence, linear) if _NEEDED.get(term.depends_on) not in missing]
    # a wave that is turned shows what depends on rate, whatever its name
    turned = [c for a, c in bank if a.form == "Omega x, crossed" and a.location == "dynamics"]
    report(0.75, "noise")
    drifts = slow_drifts(evidence, linear)
    saturated = _saturated(evidence, [*nuisances, *drifts], candidates, turned)
    of_rate = [*nuisances, *drifts, *effect_columns([*turned, *(candidates[n][0] for n in candidates if "rate" in EFFECTS[n].needs)])]
    noise, excess = measured_noise(evidence, saturated, of_rate, angular_gain)
    whitener = Whitener.of(evidence, noise, excess)
    target = target_of(evidence, angular_gain)
    rich = solve(saturated, whitener.design(saturated, len(evidence)), whitener.rows(target))
    moved = _wander(evidence, rich, wander)
    nuisances = [
        *with_wander(nuisances, moved),
        *slow_columns(evidence, linear, moved["shift"]),
        *with_drifts(drifts, measured_drifts(rich)),
    ]
    base = solve(nuisances, whitener.design(nuisances, len(evidence)), whitener.rows(target))
    report(1.0, "noise")
    return CampaignModel(evidence, linear, noise, whitener, tuple(nuisances), candidates, bank, Screener(whitener, nuisances, target), base)


def _wander(evidence: CampaignEvidence, rich: Solution, before: float) -> dict[str, float]:
    """How the resonance moves between and within recordings, while everything that could be an effect is allowed for."""
    found = {}
    for kind in ("shift", "slide"):
        places = [
            k for k, c in enumerate(rich.columns) if c.name.split("_")[0] == kind and evidence.recordings[int(c.name.split("_")[1])].is_wave
        ]
        squares = rich.values[places] ** 2 + np.diag(rich.covariance)[places]
        found[kind] = float(np.clip(np.sqrt(squares.mean()), _LEAST_WANDER * before, _MOST_WANDER * before)) if places else before
    return found


def _nuisances(evidence: CampaignEvidence, linear: Linear, wander_rad_s: float) -> list[Column]:
    return [
        *linear_columns(evidence, linear),
        *frequency_columns(evidence),
        *thermal_columns(evidence, linear),
        *wander_columns(evidence, wander_rad_s),
    ]


def _linear(evidence: CampaignEvidence, columns: list[Column], angular_gain: float, known_gain: float) -> tuple[Linear, dict[str, float]]:
    """The linear device of a fit with rough noise, and all its values; ``known_gain``: response to rate that is taken as known."""
    whitener = Whitener.of(evidence, first_noise(evidence))
    target = whitener.rows(target_of(evidence, known_gain))
    values = solve(columns, whitener.design(columns, len(evidence)), target).by_name()
    return linear_of(evidence, values, angular_gain), values


def _resonant(evidence: CampaignEvidence, columns: list[Column], angular_gain: float) -> Linear:
    """The linear device with where its resonance lay in every record: that asks for noise of the right size, of a fit without effects."""
    noise, excess = measured_noise(evidence, columns, columns, angular_gain)
    whitener = Whitener.of(evidence, noise, excess)
    values = solve(columns, whitener.design(columns, len(evidence)), whitener.rows(target_of(evidence, angular_gain))).by_name()
    return linear_of(evidence, values, angular_gain)


def _open_drive(evidence: CampaignEvidence) -> bool:
    """Whether open drive of both axes tells the feedthrough; otherwise what changes fast is told from the loops' noise by nothing."""
    return {e.axis for r in evidence if (e := r.recording.command.excitation).kind == "drive"} == {"x", "y"}


def _missing(evidence: CampaignEvidence) -> set[str]:
    """What these recordings do not have, of what effects need.

    A resonance that answers the drive answers the drive's noise, and that follows the pick-off's where the loops are closed: without
    an open drive, side bands or a switched drive nothing tells a lag from it. A temperature that only wanders is the thermometer's noise.
    """
    told = _open_drive(evidence)
    commands = [r.recording.command for r in evidence]
    changed = any(c.excitation.kind.endswith("modulation") or c.mode in SWITCHED for c in commands)
    there = {"open drive": told, "side bands": told or changed, "temperature": span_k(evidence) >= TEMPERATURE_SPAN_K}
    return {name for name, yes in there.items() if not yes}


def _saturated(
    evidence: CampaignEvidence, nuisances: Sequence[Column], candidates: Mapping[str, Sequence[Candidate]], turned: Sequence[Candidate]
) -> list[Column]:
    """Every effect at once, each of a size that it may have, and unnamed terms of rate.

    Drive and pick-off that pass through one filter obey the linear flow as before: a memory of the one against the same of the other holds
    no signal, but all of the noise, so of such twins one is enough. Where no open drive of both axes told the feedthrough, without the lag
    of a record and what has a memory: in a closed loop the drive's noise follows from the pick-off's, and a lag that is free would explain
    the noise away. A feedthrough keeps to its prior.
    """
    told = {name: tried for name, tried in candidates.items() if _TWIN.get(name) not in candidates}
    chosen = [c for tried in told.values() for c in tried[:: max(1, len(tried) // _SATURATED_SETTINGS)]]
    if not _open_drive(evidence):
        nuisances = [c for c in nuisances if not c.name.startswith("drive_lag")]
        chosen = [c for c in chosen if c.name not in _FAST]
    held = [c for c in effect_columns([*chosen, *turned]) if any(np.any(v) for v in c.signal)]
    # few recordings have no equations for all of that: it would explain their noise
    few = len(nuisances) + len(held) > _SATURATION * sum(2 * r.signal.lhs.size for r in evidence)
    return list(nuisances) if few else [*nuisances, *held]
