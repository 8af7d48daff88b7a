"""One look at a campaign: projected, its noise measured, its nuisances fitted, ready to be screened."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..recording.applied_rate import is_turned
from ..recording.recording import Recording
from .anonymous import HEATED, Anonymous, anonymous_candidates
from .candidates import candidate_at, candidates_of
from .column import Column
from .courses import Courses, courses_of
from .device_fit import first_linear, fitted_device, nuisances_of
from .drifts import without_bent
from .evidence import CHANNELS, CampaignEvidence
from .flickers import flickers
from .floors import course_beside_floors, hidden_by_floors
from .flow_left import flows_left
from .healthy import HealthySpread
from .linear_device import target_of
from .missing import missing_of, needed_by
from .monomials import LATE, RISING, WARM_FED
from .noise import PlainNoise, measured_noise, plain_noise, remeasured, with_repeats
from .nuisance import slow_columns
from .parts import Linear, Setting
from .phase_floors import phase_floors
from .preflight import check_linear
from .rate_table import healthy_phases
from .saturated import columns_of_time, counting, effect_columns, is_of_time, saturated_columns
from .screen import Candidate, Screened, Screener, worth
from .sizes import Family, measured_shares, with_shares
from .slow import MOST_WANDER, drift_family, slow_drifts
from .stiffness_image import less_stiffness_images
from .system import NoiseByRole, Solution, Whitener, solve
from .thermometer import THERMOMETER, own_columns, sensor_late_s, thermometer_columns
from .wander_feeds import wander_feeds

__all__ = ["CampaignModel", "look_at"]

ComplexArray = NDArray[np.complex128]
#: a usual wander of a resonance between records, over its frequency
_WANDER = 5e-8
#: on what unnamed terms of the saturated model depend
_STRANGE = ("amplitude", "azimuth", "drive", "temperature")
#: log evidence of a course of time from which on it is allowed for when the noise is measured: what any unnamed term must have
_COURSE = 15.0
#: noise of a recording that shall say nothing, over its own, in power
_SILENT = 1e8


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
    courses : Courses
        Courses of time without a name.
    screener : Screener
        Against the nuisances alone.
    base : Solution
    excess : mapping
        By how much the noise of a recording's channel is larger than that of its kind, by index and channel.
    late_s : mapping
        How much later than its log a table turned, by index of the recording; that is mended in ``evidence``.
    sensor_s : float
        How late the thermometer is [s], if it is later than a good one.
    largest : mapping
        Priors of drifts as large as they may be, by column; in ``nuisances`` they are as large as they are.
    """

    evidence: CampaignEvidence
    linear: Linear
    noise: NoiseByRole
    whitener: Whitener
    nuisances: tuple[Column, ...]
    candidates: Mapping[str, Sequence[Candidate]]
    bank: Sequence[tuple[Anonymous, Candidate]]
    courses: Courses
    screener: Screener
    base: Solution
    excess: Mapping[tuple[int, str], float] = field(default_factory=dict)
    late_s: Mapping[int, float] = field(default_factory=dict)
    sensor_s: float = 0.0
    largest: Mapping[str, float] = field(default_factory=dict)

    def candidate(self, name: str, setting: Setting) -> Candidate:
        """An effect at another setting than those of its grid."""
        return candidate_at(self.evidence, self.linear, name, setting, len(self.candidates[name]))

    def grid(self, name: str, key: str) -> list[Candidate]:
        """An effect at the settings that have this one: some have settings of two kinds (`levels.dead_settings`)."""
        return [c for c in self.candidates[name] if key in c.setting]

    @cached_property
    def _turned(self) -> tuple[int, ...]:
        return tuple(r.index for r in self.evidence if is_turned(r.recording))

    def at_rest(self, found: Screened, others: Sequence[Candidate]) -> Screened | None:
        """An effect beside others as the recordings show it that were not turned: a table does things besides its log."""
        return self.seen_without(self._turned, found, others)

    def seen_without(self, recordings: Sequence[int], found: Screened, others: Sequence[Candidate]) -> Screened | None:
        """An effect beside others as all but some recordings show it, given by index."""
        return self.without(recordings, others).screen(found.candidate) if recordings else found

    def taken_at_rest(self, found: Screened, others: Sequence[Candidate]) -> float:
        """Chi-square that an effect of the size it has in all recordings takes away from those that were not turned."""
        return self.without(self._turned, others).taken(found)

    def without(self, recordings: Sequence[int], others: Sequence[Candidate]) -> Screener:
        """Screens what effects leave of all but some recordings, given by index."""
        silent = {(index, channel): _SILENT for index in recordings for channel in CHANNELS}
        whitener = Whitener.of(self.evidence, self.noise, {**self.excess, **silent})
        return Screener(whitener, [*self.nuisances, *effect_columns(others)], self.target)

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


def look_at(
    recordings: Sequence[Recording],
    decay_rate: float,
    angular_gain: float,
    *,
    without: Iterable[str] = (),
    healthy: HealthySpread | None = None,
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
    healthy : HealthySpread, optional
        How large what no one calls a gap is on a device of this fleet; of any device where it is not given.
    on_progress : callable, optional
        (fraction, what is done).
    """
    report = on_progress or (lambda fraction, text: None)
    report(0.0, "projecting")
    evidence = CampaignEvidence.of(recordings, decay_rate, healthy)
    report(0.25, "fitting the linear device")
    wander, most = _WANDER * evidence.omega0_rad_s, MOST_WANDER * evidence.omega0_rad_s
    linear, rough, drives_sd = first_linear(evidence, angular_gain, wander)
    check_linear(linear, rough, recordings, decay_rate, drives_sd)
    evidence, linear, values, late_s = fitted_device(evidence, linear, angular_gain, wander, most)
    angular_gain = linear.angular_gain
    evidence = less_stiffness_images(replace(evidence, phase_floors=phase_floors(flows_left(evidence, linear))), linear)
    report(0.35, "effects of the registry")
    # a resonance that wanders with its temperature: the sensor does not say so
    error_k = most / abs(linear.frequency_slope_rad_s_k) if linear.followed is not None and linear.frequency_slope_rad_s_k else 0.0
    errs = thermometer_columns(evidence, linear, values, error_k) if error_k else []
    nuisances = healthy_phases(nuisances_of(evidence, linear, most, wander), angular_gain, values)
    nuisances = [*nuisances, *errs, *own_columns(evidence, linear, values), *wander_feeds(evidence, linear)]
    candidates = candidates_of(evidence, linear, without, lambda f: report(0.35 + 0.4 * f, "effects of the registry"))
    missing = missing_of(evidence)
    candidates = {name: tried for name, tried in candidates.items() if not missing & set(EFFECTS[name].needs)}
    bank = [(term, c) for term, c in anonymous_candidates(evidence, linear) if not missing & needed_by(term)]
    sensor_s = sensor_late_s(values)
    bank = [(term, c) for term, c in bank if not (sensor_s and term.form.startswith(RISING))]
    courses = courses_of(evidence, linear, read_late=sensor_s > 0.0)
    report(0.75, "noise")
    # a factory that errs in its angular gain would make the floor of what is turned: 33 times too loud at 1.3 %
    turning = effect_columns(candidates.get("angular_gain_error", ())[:1])
    plain = plain_noise(evidence, [*nuisances, *turning], angular_gain)
    drifts = slow_drifts(evidence, linear, flickers(evidence, linear, plain.noise))
    told = without_bent(candidates)
    whitener, noise, excess, held = _weighed(evidence, linear, nuisances, drifts, told, bank, angular_gain, most, plain)
    screener = Screener(whitener, held, target_of(evidence, angular_gain))
    course = courses.best(screener, whitener)
    # what goes with time is no noise of repeats, nor a floor
    if course is not None and worth(course[0].gain, course[0].rank, course[0].candidate.choices) > _COURSE:
        candidate: Candidate | None = course[0].candidate
    else:
        candidate = course_beside_floors(courses, whitener, target_of(evidence, angular_gain), held, drifts)
    if candidate is None:
        candidate = _course_of_warming(evidence, courses, noise, excess, held, angular_gain)
    found = [] if candidate is None else [candidate]
    if found:
        whitener, noise, excess, held = _weighed(evidence, linear, nuisances, drifts, told, bank, angular_gain, most, plain, found)
    # and what stands still may have made a floor what it seems
    named = [c for name, tried in candidates.items() if not is_of_time(name) for c in tried]
    beside = [*held, *effect_columns(found)]
    if hidden := hidden_by_floors(named, whitener, target_of(evidence, angular_gain), beside, drifts):
        found += hidden
        whitener, noise, excess, held = _weighed(evidence, linear, nuisances, drifts, told, bank, angular_gain, most, plain, found)
    screener = Screener(whitener, held, target_of(evidence, angular_gain))
    base = solve(held, whitener.design(held, len(evidence)), whitener.rows(target_of(evidence, angular_gain)))
    report(1.0, "noise")
    largest = {c.name: c.prior_sd for c in drifts}
    return CampaignModel(
        evidence, linear, noise, whitener, tuple(held), candidates, bank, courses, screener, base, excess, late_s, sensor_s, largest
    )


def _weighed(
    evidence: CampaignEvidence,
    linear: Linear,
    nuisances: Sequence[Column],
    drifts: Sequence[Column],
    candidates: Mapping[str, Sequence[Candidate]],
    bank: Sequence[tuple[Anonymous, Candidate]],
    angular_gain: float,
    most_rad_s: float,
    plain: PlainNoise,
    strangers: Sequence[Candidate] = (),
) -> tuple[Whitener, NoiseByRole, Mapping[tuple[int, str], float], list[Column]]:
    """Noise, measured with all effects and ``strangers`` allowed for, and the nuisances at the sizes that they have."""
    # a wave that is turned shows what depends on rate, whatever its name: an asymmetry of 1239 that had none was its noise
    turned = [c for a, c in bank if a.form in ("Omega x, crossed", "Omega^2 x, crossed") and a.location == "dynamics"]
    strange = [c for a, c in bank if _is_strange(a) and not c.setting and (a.form, a.phase) != HEATED]
    # whether the registry has a name for a drift or not, a floor is what does not go along a straight line
    straight = [c for a, c in bank if a.depends_on == "time"]
    held = [*nuisances, *drifts]
    unnamed = [*turned, *strange, *straight]
    plainly = Screener(Whitener.of(evidence, plain.noise), nuisances, target_of(evidence, angular_gain))
    # what lags behind the temperature shows in two or three records, which drifts of their own follow as well
    asked = [*unnamed, *(c for tried in candidates.values() for c in tried)]
    shown = counting(plainly, asked, first=[c.name for a, c in bank if a.form.startswith(LATE)])
    allowed = [*saturated_columns(evidence, linear, held, candidates, unnamed, shown), *effect_columns(strangers)]
    of_rate = [*held, *effect_columns([*turned, *(candidates[n][0] for n in candidates if "rate" in EFFECTS[n].needs)])]
    noise, excess = measured_noise(evidence, allowed, of_rate, angular_gain, plain)
    whitener = Whitener.of(evidence, noise, excess)
    target = target_of(evidence, angular_gain)
    family = _random_family(evidence)
    going = [*columns_of_time(candidates), *effect_columns([*straight, *strangers])]
    shares = _random_shares(evidence, family, [allowed, [*held, *going]], whitener, whitener.rows(target))
    # what wanders is the temperature: its sensor errs in the same share; a part of it may stand in the noise of means
    shares["wander"] = min(math.hypot(shares["shift"], _wander_of_means(evidence, noise) / most_rad_s), 1.0)
    sized = with_shares(
        [*held, *slow_columns(evidence, linear, most_rad_s * shares["wander"])],
        lambda c: "wander" if c.name.startswith(THERMOMETER) else family(c),
        shares,
    )
    # once the drifts have their size, repeats have the freedom to say how far a mean errs by itself
    noise = with_repeats(evidence, with_shares(allowed, family, shares), noise, excess, target)
    # and what effects by the score take of that freedom, those that may be there leave
    screener = Screener(Whitener.of(evidence, noise, excess), sized, target)
    there = counting(screener, [*(c for tried in candidates.values() for c in tried), *turned, *strange])
    named = {name: tried for name, tried in candidates.items() if name in there}
    unnamed = [c for c in [*turned, *strange] if c.name in there]
    lean = saturated_columns(evidence, linear, sized, named, unnamed, there)
    noise = remeasured(evidence, [*lean, *going], noise, excess, angular_gain)
    return Whitener.of(evidence, noise, excess), noise, excess, sized


def _is_strange(term: Anonymous) -> bool:
    return term.depends_on in _STRANGE or term.form == WARM_FED or term.form.startswith(LATE)


def _course_of_warming(
    evidence: CampaignEvidence,
    courses: Courses,
    noise: NoiseByRole,
    excess: Mapping[tuple[int, str], float],
    held: Sequence[Column],
    angular_gain: float,
) -> Candidate | None:
    """A course of the temperature that counts if recordings that are warmed are as quiet as the others of their mode.

    What happens at one temperature happens in a few seconds of two or three recordings, and is their noise unless it is allowed for.
    """
    quiet = {
        r.noise_key(channel): noise[r.parent_role, channel]
        for r in evidence
        for channel in CHANNELS
        if r.is_warming and channel != "frequency" and (r.parent_role, channel) in noise
    }
    alike = {(index, channel): more for (index, channel), more in excess.items() if not evidence.recordings[index].is_warming}
    whitener = Whitener.of(evidence, {**noise, **quiet}, alike)
    found = courses.best(Screener(whitener, held, target_of(evidence, angular_gain)), whitener, "temperature")
    if found is None or worth(found[0].gain, found[0].rank, found[0].candidate.choices) < _COURSE:
        return None
    return found[0].candidate


def _wander_of_means(evidence: CampaignEvidence, noise: NoiseByRole) -> float:
    """How far the mean frequencies of records are noise beside their own shifts, sd [rad/s]."""
    found = []
    for r in evidence:
        lines = r.lines("frequency")
        if r.is_wave and not r.is_warming and lines.is_mean.any():
            slow = noise[r.noise_key("frequency")].slow(lines)[lines.is_mean]
            found.append(float(slow[0]) / (lines.scale * r.recording.duration_s))
    return math.sqrt(float(np.median(found))) if found else 0.0


def _random_shares(
    evidence: CampaignEvidence, family: Family, models: Sequence[Sequence[Column]], whitener: Whitener, target: NDArray[np.float64]
) -> dict[str, float]:
    """How much of their largest size the resonance's wander and the slow drifts have: the smallest that any of these models says."""
    shares = {"shift": 1.0, "slide": 1.0}
    for columns in models:
        found = measured_shares(solve(columns, whitener.design(columns, len(evidence)), target), family)
        shares |= {name: min(share, shares.get(name, share)) for name, share in found.items()}
    return shares


def _random_family(evidence: CampaignEvidence) -> Family:
    """Families of random nuisances: where the resonance of a wave lies, how it moves meanwhile, what drifts.

    Where it lay under an open drive stays what a usual device may have: that one does not follow it, and its phase tells more than this.
    """
    waves = {f"{kind}_{r.index}": kind for r in evidence for kind in ("shift", "slide") if r.is_wave}
    return lambda c: waves.get(c.name) or drift_family(c)
