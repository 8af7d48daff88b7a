"""A diagnosis as rows of text, once for the terminal and the page."""

from __future__ import annotations

from collections.abc import Sequence

from ..gap.diagnosis import Alternative, Diagnosis, FoundEffect, Standing
from ..gap.drifts import BENT
from ..quantity import Quantity
from .table import Table, number, quantity_cells

__all__ = [
    "as_healthy_table",
    "before_after_table",
    "effects_table",
    "places_table",
    "sentences_of_next",
    "standings_table",
    "status_words",
]

#: effects that are named of those that an experiment decides
_NAMED = 6


def effects_table(diagnosis: Diagnosis) -> Table:
    """What was found: sizes, probability, and what these data cannot tell from it."""
    rows = []
    for effect in diagnosis.effects:
        for k, (name, quantity) in enumerate(effect.parameters.items()):
            value, sd, unit = quantity_cells(quantity)
            first = (effect.name, f"{100.0 * effect.probability:.1f} %", effect.location, _others(effect)) if k == 0 else ("", "", "", "")
            size = f"{name} = {value} ± {sd}" + ("" if unit == "1" else f" {unit}")
            rows.append((first[0], size, *first[1:]))
        if BENT in effect.title:
            rows.append(("", "a course that " + effect.title.split(BENT)[1], "", "", ""))
    for words, probability in _beside_the_named(diagnosis):
        rows.append((words, "", _percent(probability), "", ""))
    header = ("effect", "size", "probability", "acts in", "cannot be told from")
    caption = "" if rows else "Nothing is told of any effect."
    return Table("Which effects", header, tuple(rows), caption, optional=(3, 4))


def _beside_the_named(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Probability of what no row above names, which adds up to 1 where none does."""
    none, unknown = diagnosis.probability_none, diagnosis.probability_unknown
    if diagnosis.verdict == "not_testable":
        # they are of the few effects that could be tested: "none of any kind 81 %" is not what such recordings say
        return []
    if diagnosis.effects:
        others = "another, or not in the catalogue" if diagnosis.unknown is None else "beside it one that is not in the catalogue"
        return [("none of any kind", none), (others, unknown)]
    of_catalogue = "one of the catalogue" if diagnosis.unknown is not None else "one of the catalogue, too small to see"
    return [("none of any kind", none), (of_catalogue, max(1.0 - none - unknown, 0.0)), ("not in the catalogue", unknown)]


def places_table(diagnosis: Diagnosis, count: int = 3) -> Table:
    """The worst places of the map."""
    rows = tuple(
        (
            cell.experiment,
            cell.channel,
            cell.feature,
            cell.quadrature.removeprefix("in phase with "),
            f"{cell.left_out:.3g}",
            f"{100.0 * cell.share:.1f} %",
        )
        for cell in diagnosis.map[:count]
        if cell.share > 0.0
    )
    header = ("experiment", "channel", "line", "in phase with", "times its noise", "share of the gap")
    return Table("Where the gap lies, the worst places", header, rows, "" if rows else "No place stands out of the noise.")


def as_healthy_table(diagnosis: Diagnosis) -> Table:
    """What no one calls a gap, for healthy devices may have it, but no drawing has."""
    rows = []
    for held in diagnosis.as_healthy:
        for k, (name, quantity) in enumerate((held.told or held.parameters).items()):
            value, sd, unit = quantity_cells(quantity)
            size = f"{name} = {value} ± {sd}" + ("" if unit == "1" else f" {unit}")
            last = (f"{held.times_usual:.2g}", f"{held.gain:.0f}") if k == 0 else ("", "")
            rows.append((held.name if k == 0 else "", size, *last))
    caption = (
        "Healthy devices are known that have as much, so that none of it is called an effect; healthy units of your own decide "
        "(gyro-calib fleet). Chi-square: what the linear device would leave without it."
    )
    header = ("effect", "size", "times the usual", "chi-square")
    return Table("As healthy devices may have it", header, tuple(rows), caption if rows else "Nothing that shows.")


def before_after_table(diagnosis: Diagnosis) -> Table:
    """How far the gap shrinks on experiments that the sizes were not found on."""
    gap = diagnosis.gap
    rows = (
        ("misfit, rms over noise (1: noise alone)", f"{gap.rms_before:.3g}", f"{gap.rms_after:.3g}", ""),
        ("rate left unexplained [deg/h]", *_figures(gap.bias_before, gap.bias_after, "bias" not in gap.untold())),
        ("bend of the scale factor [ppm]", *_figures(gap.scale_before, gap.scale_after, "scale" not in gap.untold())),
    )
    caption = (
        f"{100.0 * gap.closed_fraction.value:.1f} ± {100.0 * gap.closed_fraction.sd:.2g} % of the gap is closed."
        if diagnosis.effects and gap.closed_fraction.sd < 1.0
        else ""
    )
    return Table("Before and after, on experiments that were not used for finding it", ("", "before", "after", "sd"), rows, caption)


def standings_table(diagnosis: Diagnosis) -> Table:
    """Every effect of the registry: present, excluded above a size, cannot tell, not testable."""
    probability = {name: e.probability for e in diagnosis.effects for name in e.group}
    rows = tuple(
        (
            s.name,
            status_words(s),
            f"{100.0 * probability[s.name]:.1f} %" if s.name in probability else "",
            s.location,
            f"{s.gain:.1f}",
            f"{100.0 * s.absorbed:.0f} %",
        )
        for s in diagnosis.standings
    )
    header = ("effect", "what the recordings say", "probability", "acts in", "chi-square", "absorbed")
    caption = (
        "Probability: of the group that an effect stands in. Chi-square: what the effect would take away beside those found. "
        "Absorbed: share that the constants of a linear device take up."
    )
    return Table(f"All {len(rows)} effects, ranked", header, rows, caption, optional=(5, 4, 3, 2))


def status_words(standing: Standing) -> str:
    """Status with the size above which an absent effect would have been seen nine times in ten."""
    limit = standing.excluded_above
    if limit is None:
        return standing.status
    size = f"{limit.value:.2g} {limit.unit}" if limit.unit != "1" else f"{limit.value:.2g}"
    if standing.status == "excluded":
        return f"excluded above {size}"
    return f"{standing.status} below {size}"


def sentences_of_next(diagnosis: Diagnosis) -> Sequence[str]:
    """What to record next and why, then the alternatives."""
    following = diagnosis.next_experiment
    return (
        f"{following.description} Purpose: {following.purpose}.",
        *(f"Or: {a.description}{_decides(a)}" for a in following.alternatives),
    )


def _decides(alternative: Alternative) -> str:
    if not alternative.splits:
        return ""
    named = ", ".join(alternative.splits[:_NAMED])
    return f" It decides {named}{' and more' if len(alternative.splits) > _NAMED else ''}."


def _others(effect: FoundEffect) -> str:
    return ", ".join(name for name in effect.group if name != effect.name)


def _percent(probability: float) -> str:
    return f"{100.0 * probability:.1f} %"


def _figures(before: Quantity, after: Quantity, told: bool) -> tuple[str, str, str]:
    return (_plain(before), _plain(after), f"{after.sd:.2g}") if told else ("unknown", "unknown", "")


def _plain(quantity: Quantity) -> str:
    return number(quantity.value, max(quantity.sd, 1e-3 * abs(quantity.value)))
