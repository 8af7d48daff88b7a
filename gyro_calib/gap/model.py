"""One look at a campaign: projected, its noise measured, its nuisances fitted, ready to be screened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..recording.recording import Recording
from .candidates import candidate_at, candidates_of
from .columns import Column
from .evidence import CampaignEvidence
from .forms import Linear, Setting
from .noise import first_noise, measured_noise
from .nuisance import frequency_columns, linear_columns, linear_of, slow_columns, target_of, thermal_columns, wander_columns, with_wander
from .preflight import check_linear
from .screen import Candidate, Screener
from .system import NoiseByRole, Solution, Whitener, solve

__all__ = ["CampaignModel", "look_at"]

ComplexArray = NDArray[np.complex128]
#: resonance wander between records before it is known, over its frequency; least and most that are believed, over that
_WANDER, _LEAST_WANDER, _MOST_WANDER = 5e-8, 0.3, 10.0
#: of the settings of a gridded effect, how many the saturated model holds
_SATURATED_SETTINGS = 4
#: columns of the saturated model over equations, at most
_SATURATION = 0.35


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
        """The nuisances and these effects together."""
        columns = [*self.nuisances, *effect_columns(candidates)]
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
    report(0.35, "effects of the registry")
    nuisances = _nuisances(evidence, linear, wander)
    candidates = candidates_of(evidence, linear, without, lambda f: report(0.35 + 0.4 * f, "effects of the registry"))
    report(0.75, "noise")
    of_rate = [*nuisances, *(c for name in candidates if "rate" in EFFECTS[name].needs for c in candidates[name][0].columns)]
    noise, excess = measured_noise(evidence, _saturated(evidence, nuisances, candidates), of_rate, angular_gain)
    whitener = Whitener.of(evidence, noise, excess)
    target = target_of(evidence, angular_gain)
    moved = _wander(evidence, _saturated(evidence, nuisances, candidates), whitener, target, wander)
    nuisances = [*with_wander(nuisances, moved), *slow_columns(evidence, linear, moved["shift"])]
    base = solve(nuisances, whitener.design(nuisances, len(evidence)), whitener.rows(target))
    report(1.0, "noise")
    return CampaignModel(evidence, linear, noise, whitener, tuple(nuisances), candidates, Screener(whitener, nuisances, target), base)


def _wander(
    evidence: CampaignEvidence, saturated: list[Column], whitener: Whitener, target: list[ComplexArray], before: float
) -> dict[str, float]:
    """How the resonance moves between and within recordings, while everything that could be an effect is allowed for."""
    solution = solve(saturated, whitener.design(saturated, len(evidence)), whitener.rows(target))
    found = {}
    for kind in ("shift", "slide"):
        places = [
            k
            for k, c in enumerate(solution.columns)
            if c.name.split("_")[0] == kind and evidence.recordings[int(c.name.split("_")[1])].is_wave
        ]
        squares = solution.values[places] ** 2 + np.diag(solution.covariance)[places]
        found[kind] = float(np.clip(np.sqrt(squares.mean()), _LEAST_WANDER * before, _MOST_WANDER * before)) if places else before
    return found


def _nuisances(evidence: CampaignEvidence, linear: Linear, wander_rad_s: float) -> list[Column]:
    return [
        *linear_columns(evidence),
        *frequency_columns(evidence, linear.E),
        *thermal_columns(evidence, linear),
        *wander_columns(evidence, wander_rad_s),
    ]


def _linear(evidence: CampaignEvidence, columns: list[Column], angular_gain: float, known_gain: float) -> tuple[Linear, dict[str, float]]:
    """The linear device of a fit with rough noise, and all its values; ``known_gain``: response to rate that is taken as known."""
    whitener = Whitener.of(evidence, first_noise(evidence))
    target = whitener.rows(target_of(evidence, known_gain))
    values = solve(columns, whitener.design(columns, len(evidence)), target).by_name()
    return linear_of(evidence, values, angular_gain), values


def _saturated(evidence: CampaignEvidence, nuisances: Sequence[Column], candidates: Mapping[str, Sequence[Candidate]]) -> list[Column]:
    """Everything at once, as far as there are equations for it.

    Where no open drive of both axes told the feedthrough, the nuisances without it: in a closed loop the drive's noise follows from the
    pick-off's, and a feedthrough or a lag that is free would explain the noise away.
    """
    excitations = [r.recording.command.excitation for r in evidence]
    if {e.axis for e in excitations if e.kind == "drive"} < {"x", "y"}:
        return [c for c in nuisances if not c.name.startswith(("E_", "drive_lag"))]
    most = _SATURATION * sum(2 * r.signal.lhs.size for r in evidence)
    for settings in (_SATURATED_SETTINGS, 1):
        columns = list(nuisances)
        for tried in candidates.values():
            for candidate in tried[:: max(1, len(tried) // settings)]:
                columns += [c for c in candidate.columns if any(np.any(v) for v in c.signal)]
        if len(columns) < most:
            return columns
    return list(nuisances)
