"""Where a device differs from the simulation, which effect causes it, and how far the gap shrinks once that effect is added (gap.md)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..effects import EFFECTS, INSEPARABLE
from ..errors import DataError
from ..estimation.factory_values import factory_value
from ..quantity import Quantity
from ..recording.recording import Campaign
from ..units import DEG_H, PPM
from .as_healthy import as_healthy
from .candidates import registry_name
from .checks import checked
from .coarse_drive import FULL_SCALE_V, with_coarse_drive
from .diagnosis import Diagnosis, FoundEffect, Gap, PatchedEstimate, Standing, Unknown
from .drifts import said_course
from .fleet import coefficients_of
from .flicker_effects import with_flickers, without_walked
from .flow_left import FlowLeft, flows_left
from .gap_map import gap_map
from .healthy import HealthySpread
from .heldout import Shrinkage, halves_disagree, shrinkage, shrinkage_of_halves
from .jumps import Jumps, find_jumps
from .linear_device import linear_of
from .loop_effects import loop_effects
from .loud import loudest
from .model import CampaignModel, look_at
from .near_tones import find_near_tone, heard_on_lines
from .next_experiment import experiment_for, next_experiment
from .one_device import said_of_decay
from .open_lines import find_open_line
from .periods import find_period
from .probabilities import beside_unknown, none_or_unknown
from .rate_table import said_late
from .reciprocity import reciprocity
from .ringing import find_ringing
from .screen import Candidate, Screened
from .select import Selection, select_effects
from .spectral_effects import SpectralEffects, spectral_effects
from .standing import standings
from .steady_swings import find_steady_swing, swings_at_rest
from .strangers import MARGIN, Stranger, unnamed_rest, worth_of
from .summary import summary_of
from .swings import Swing, find_swing
from .system import Solution
from .thermometer import said_sensor_late
from .told import told_sizes
from .unseen_steps import with_unseen_steps

__all__ = ["diagnose"]

#: share of the gap of unseen experiments that an effect of the right form closes at least, within so many standard deviations
_LEAST_CLOSED, _SIGMAS = 0.5, 3.0


def diagnose(
    campaign: Campaign,
    *,
    without: Iterable[str] = (),
    healthy: HealthySpread | None = None,
    on_progress: Callable[[float, str], None] | None = None,
) -> Diagnosis:
    """Diagnose a campaign of force-rebalance or whole-angle recordings.

    Parameters
    ----------
    campaign : Campaign
        Recordings of one device; ``factory`` with ``angular_gain_kappa``, ``nominal_f0_hz`` and ``nominal_q``.
    without : iterable of str
        Effects that the registry shall not hold (blind trials).
    healthy : HealthySpread, optional
        How large what no one calls a gap is on devices of this fleet (`fleet.py`); as of any device where it is not given.
    on_progress : callable, optional
        (fraction, what is done).

    Raises
    ------
    DataError
        Recordings that contradict their attributes or themselves: names the recording and the remedy.
    """
    try:
        return _diagnose(campaign, tuple(without), healthy or HealthySpread(), on_progress or (lambda fraction, text: None))
    except np.linalg.LinAlgError as error:
        said = f"{campaign.device_id} must tell a linear device and its noise, but the equations have no solution ({error})"
        raise DataError(f"Recordings of {said}. Record with all the converters' steps: columns of a few values do that.") from error


def _diagnose(campaign: Campaign, left_out: tuple[str, ...], healthy: HealthySpread, report: Callable[[float, str], None]) -> Diagnosis:
    begun = time.monotonic()
    kappa, f0, q = (_factory(campaign, name) for name in ("angular_gain_kappa", "nominal_f0_hz", "nominal_q"))
    recordings, warnings = checked(campaign, kappa, math.pi * f0 / q)
    model = look_at(
        recordings, math.pi * f0 / q, kappa, without=left_out, healthy=healthy, on_progress=lambda f, text: report(0.7 * f, text)
    )
    late = [*said_late(model.evidence, model.late_s), *said_sensor_late(model.sensor_s)]
    warnings += [*said_of_decay(model.linear.A, math.pi * f0 / q), *late]
    report(0.7, "selecting effects")
    flows = flows_left(model.evidence, model.linear)
    swings = [swing for swing in (find_swing(flows), find_steady_swing(flows)) if swing is not None]
    open_line = find_open_line(recordings, model.linear, model.evidence.omega0_rad_s, model.evidence.temperature_degc)
    near_tone = find_near_tone(flows, model.linear)
    beside = spectral_effects(recordings, model.linear, left_out, swings, near_tone, open_line)
    if near_tone is not None and not beside.near:
        beside = replace(beside, near=heard_on_lines(model.evidence, near_tone.frequency_hz))
    full_scale_v = factory_value(campaign.factory, "dac_full_scale_V") or FULL_SCALE_V
    beside = with_coarse_drive(beside, model, recordings, left_out, full_scale_v)
    beside = with_flickers(beside, model.evidence, model.linear, model.noise, left_out)
    selection = select_effects(model)
    beside = with_unseen_steps(beside, model, selection, left_out)
    selection = _without_products(model, selection, beside)
    beside = _swaying_at_rest(beside, flows, swings) if selection.effects else beside
    chosen = [e.candidate for e in selection.effects]
    beside = without_walked(beside, chosen)
    rich = model.fitted(chosen) if chosen else model.base
    report(0.88, "unseen experiments")
    shrunk = shrinkage(model, chosen)
    report(0.93, "what else could be seen")
    lines = standings(model, selection, left_out)
    effects = tuple(_found(model, selection, k, rich, left_out) for k in range(len(selection.effects)))
    loops = loop_effects(recordings, campaign.factory, left_out)
    circulatory, circulatory_line = reciprocity(
        model.evidence, rich, model.linear.angular_gain, [e.registry_name for e in effects], left_out
    )
    effects, lines = _loudest_first(effects + beside.effects), _in_order(lines + beside.standings + loops.standings + circulatory_line)
    unknown = (
        _unknown(selection.stranger)
        or (None if effects else beside.unknown)
        or _not_of_its_form(model, selection, shrinkage_of_halves(model, chosen))
        or (None if beside.effects else _more_than_they_say(model, selection, shrunk))
    )
    unknown = unknown or (None if beside.effects else _within_recordings(flows, swings, bool(effects)))
    if unknown is None and not effects and (ringing := find_ringing(model.evidence, model.linear)) is not None:
        unknown = ringing.unknown()
    if (loud := loudest(model, rich)) is not None:
        warnings = [*warnings, loud.warning()]
        # what stands in spectra may be what is loud
        explained = bool(beside.effects) or loud.may_be_of(effects)
        unknown = unknown or (None if explained or loud.untested else loud.unknown())
    warnings = [*warnings, *loops.warnings]
    # of the slow flow, and of what no name fits in it, what the loops hold says nothing
    effects += loops.effects + circulatory
    untested = loud.not_testable() if loud is not None and loud.untested else ""
    verdict = _verdict(effects, unknown, lines, untested)
    effects = beside_unknown(effects, unknown)
    following = experiment_for(unknown) if unknown is not None else next_experiment(model, selection, lines)
    report(1.0, "done")
    held = as_healthy(model, chosen, rich, left_out)
    none, something = none_or_unknown(selection, (*beside.effects, *loops.effects, *circulatory), unknown, effects)
    return Diagnosis(
        device_id=campaign.device_id,
        verdict=verdict,
        summary=summary_of(verdict, effects, unknown, shrunk, lines, held, untested),
        effects=effects,
        unknown=unknown,
        map=gap_map(model, model.base),
        standings=lines,
        gap=_gap(model, rich, shrunk),
        not_testable=tuple(s.name for s in lines if s.status == "not testable"),
        next_experiment=following,
        chi2_before=selection.chi2_before,
        chi2_after=selection.chi2_after,
        dof=selection.dof,
        probability_none=none,
        probability_unknown=something,
        recordings=len(recordings),
        elapsed_s=time.monotonic() - begun,
        warnings=tuple(warnings),
        provenance={"registry": len(model.candidates), "left_out": list(left_out)},
        estimate=_estimate(model, rich, kappa),
        map_after=gap_map(model, rich) if chosen else (),
        as_healthy=held,
    )


def _estimate(model: CampaignModel, rich: Solution, kappa: float) -> PatchedEstimate:
    """``kappa``: the resonator's own; that of the model is as these pick-offs read it, and a patched device has pick-offs as well."""
    values = rich.by_name()
    linear = linear_of(model.evidence, values, model.linear.angular_gain)
    evidence = model.evidence
    return PatchedEstimate(
        linear.A, linear.G, linear.E, evidence.omega0_rad_s, evidence.temperature_degc,
        linear.frequency_slope_rad_s_k, kappa, values, coefficients_of(rich, evidence.healthy, model.largest),
    )  # fmt: skip


def _factory(campaign: Campaign, name: str) -> float:
    value = campaign.factory.get(name)
    if not isinstance(value, int | float) or not math.isfinite(value) or value <= 0.0:
        raise DataError(f"Factory data must hold {name} > 0, but got {value!r}. Add it to the file's attribute `factory`.")
    return float(value)


def _found(model: CampaignModel, selection: Selection, k: int, rich: Solution, left_out: Collection[str] = ()) -> FoundEffect:
    e, group = selection.effects[k], selection.groups[k]
    inseparable = [other for name in group for other in INSEPARABLE.get(name, ()) if other not in left_out]
    name = registry_name(e.name, e.candidate.setting)
    return FoundEffect(
        name=e.name,
        title=EFFECTS[e.name].title + said_course(e.candidate.setting),
        group=(*group, *inseparable),
        probability=selection.probabilities[k],
        parameters=told_sizes(model, selection.effects, k, rich),
        location=EFFECTS[name].location,
        registry_name=name,
        gain=e.gain,
        harmless=_harmless(model, rich),
    )


def _harmless(model: CampaignModel, rich: Solution) -> bool:
    """Whether neither the rate nor the scale factor of the linear fit moves by more than three of its standard deviations."""
    return all(abs(shift) < 3.0 * sd for shift, sd in (_rate_shift(model, rich), _scale_shift(model, rich)))


def _rate_shift(model: CampaignModel, rich: Solution) -> tuple[float, float]:
    """By how much the effects move the rate that A says [rad/s], and its sd."""
    names = [c.name for c in rich.columns]
    values, before = rich.by_name(), model.base.by_name()
    shift = 0.5 * sum(sign * (values[n] - before[n]) for n, sign in (("A_xy_re", 1.0), ("A_yx_re", -1.0)))
    places = [names.index(n) for n in ("A_xy_re", "A_yx_re")]
    weights = np.array([0.5, -0.5])
    variance = float(weights @ rich.covariance[np.ix_(places, places)] @ weights)
    kappa = model.linear.angular_gain
    return shift / kappa, math.sqrt(variance) / kappa


def _scale_shift(model: CampaignModel, rich: Solution) -> tuple[float, float]:
    """Largest relative change of a drive's gain by the effects, and its sd."""
    G, before = (linear_of(model.evidence, s.by_name(), model.linear.angular_gain).G for s in (rich, model.base))
    names = [c.name for c in rich.columns]
    found = []
    for k, axis in enumerate("xy"):
        place = names.index(f"G_{axis}{axis}_im")
        sd = math.sqrt(max(float(rich.covariance[place, place]), 0.0)) / abs(G[k, k])
        found.append((abs(G[k, k]) / abs(before[k, k]) - 1.0, sd))
    return max(found, key=lambda pair: abs(pair[0]))


def _without_products(model: CampaignModel, selection: Selection, beside: SpectralEffects) -> Selection:
    """Less what a tone or a hum may have made: its squares, by loops that follow it, and itself where an open drive stands beside it."""
    chosen = [e.candidate for e in selection.effects]
    own = [k for k, e in enumerate(selection.effects) if e.gain > beside.products]
    kept = [k for k in own if _heard_elsewhere(model, beside, selection.effects[k], [c for j, c in enumerate(chosen) if j != k])]
    stranger = selection.stranger
    if stranger is not None and not (
        stranger.screened.gain > beside.products and _heard_elsewhere(model, beside, stranger.screened, chosen)
    ):
        stranger = None
    if len(kept) == len(selection.effects):
        return replace(selection, stranger=stranger)
    return replace(
        selection,
        effects=tuple(selection.effects[k] for k in kept),
        groups=tuple(selection.groups[k] for k in kept),
        probabilities=tuple(selection.probabilities[k] for k in kept),
        stranger=stranger,
        chi2_after=model.screener_with([chosen[k] for k in kept]).chi2,
    )


def _heard_elsewhere(model: CampaignModel, beside: SpectralEffects, found: Screened, others: list[Candidate]) -> bool:
    """Whether what was found counts without the recordings whose reference stands beside a tone."""
    if not beside.near:
        return True
    still = model.seen_without(beside.near, found, others)
    return still is not None and max(still.log_evidence, worth_of(still)) > MARGIN


def _unknown(found: Stranger | None) -> Unknown | None:
    if found is None:
        return None
    term = found.term
    return Unknown(term.location, term.phase, term.form, term.depends_on, found.nearest, found.screened.gain)


def _not_of_its_form(model: CampaignModel, selection: Selection, of_halves: Shrinkage) -> Unknown | None:
    """What looks like an effect but leaves most of the gap of unseen experiments, or makes it worse, because its size is another there."""
    follows = of_halves.after < of_halves.before and of_halves.closed + _SIGMAS * of_halves.closed_sd > _LEAST_CLOSED
    if not selection.effects or follows:
        return None
    left_over = selection.chi2_after - selection.dof > _SIGMAS * math.sqrt(2.0 * selection.dof)
    if not left_over and not halves_disagree(model, [e.candidate for e in selection.effects]):
        return None
    first = selection.effects[0]
    location = EFFECTS[registry_name(first.name, first.candidate.setting)].location
    form = f"{first.name}, but by another amount in other experiments"
    return Unknown(location, "phase not told", form, "experiment", first.name, first.gain)


def _more_than_they_say(model: CampaignModel, selection: Selection, shrunk: Shrinkage) -> Unknown | None:
    """The unnamed term that says most of what effects leave, if they leave more of unseen experiments than ones of the right form."""
    if not selection.effects or not shrunk.leaves_more:
        return None
    return _unknown(unnamed_rest(model, [e.candidate for e in selection.effects]))


def _within_recordings(flows: Sequence[FlowLeft], swings: Sequence[Swing], with_effects: bool) -> Unknown | None:
    """What swings or jumps within recordings, which no line tells.

    Effects may do so where a side band or a turning wave takes them along, and settle after a command; at rest they do not swing, and
    have no period of the device's clock.
    """
    period = None if swings else find_period(flows)
    moves: list[Swing | Jumps | None] = [*swings, period, find_jumps(flows)]
    if with_effects:
        still = [flow for flow in flows if flow.is_still]
        moves = [find_swing(still), find_steady_swing(still), *(s for s in swings if s.size > 0.0 and swings_at_rest(flows, s)), period]
    found = [moved.unknown() for moved in moves if moved is not None]
    return max(found, key=lambda unknown: unknown.gain, default=None)


def _swaying_at_rest(beside: SpectralEffects, flows: Sequence[FlowLeft], swings: Sequence[Swing]) -> SpectralEffects:
    """Without a rate that goes to and fro only where effects do, in waves that turn or that a side band moves."""
    if not any(e.name == "base_sway" for e in beside.effects):
        return beside
    still = find_steady_swing([flow for flow in flows if flow.is_still])
    if (still is not None and still.is_a_rate) or any(s.is_a_rate and swings_at_rest(flows, s) for s in swings):
        return beside
    excluded = tuple(replace(s, status="excluded") if s.name == "base_sway" else s for s in beside.standings)
    return replace(beside, effects=tuple(e for e in beside.effects if e.name != "base_sway"), standings=excluded)


def _verdict(effects: tuple[FoundEffect, ...], unknown: Unknown | None, lines: tuple[Standing, ...], untested: str) -> str:
    if unknown is not None:
        return "unknown"
    if effects:
        return "effects"
    tested = sum(s.status in ("excluded", "cannot tell") for s in lines)
    return "none" if tested >= len(lines) // 4 and not untested else "not_testable"


def _loudest_first(effects: tuple[FoundEffect, ...]) -> tuple[FoundEffect, ...]:
    """Whether a fit or a spectrum found them: a tone of 14 042 stood behind what a gain of 32 goes with the temperature."""
    return tuple(sorted(effects, key=lambda e: -e.gain))


def _in_order(lines: tuple[Standing, ...]) -> tuple[Standing, ...]:
    """The present ones first, then what is like them."""
    rank = {"present": 0, "like": 1}
    return tuple(sorted(lines, key=lambda s: rank.get(s.status.split()[0], 2)))


def _gap(model: CampaignModel, rich: Solution, shrunk: Shrinkage) -> Gap:
    _, rate_sd = _rate_shift(model, rich)
    scale_shift, scale_sd = _scale_shift(model, rich)
    return Gap(
        rms_before=shrunk.rms_before,
        rms_after=shrunk.rms_surprise,
        closed_fraction=Quantity(shrunk.told, shrunk.told_sd, "1"),
        bias_before=Quantity(shrunk.rate_before / DEG_H, rate_sd / DEG_H, "deg/h"),
        bias_after=Quantity(shrunk.rate_after / DEG_H, rate_sd / DEG_H, "deg/h"),
        scale_before=Quantity(abs(scale_shift) / PPM, scale_sd / PPM, "ppm"),
        scale_after=Quantity(0.0, scale_sd / PPM, "ppm"),
        experiments=shrunk.labels,
    )
