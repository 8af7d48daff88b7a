"""Noise of a campaign, measured while everything that could be an effect is allowed for.

If the noise were measured on what the linear model leaves, an effect would raise it and hide. So it is measured on what a saturated model
leaves, one that holds every effect of the registry at once: too rich to name anything, but what it cannot follow is noise. Each residual is
corrected for its leverage. Records of a rarer kind (turned, warming) are not believed to be quieter than those of their mode, and what
repeated records differ by at their mean counts whatever the model says. Quiet lines and signal lines are pooled by role and channel, with
a density of white, flicker, random walk and pick-off terms as far as the data ask for them: a 1/f floor and a resonance that wanders by
millikelvins are noise, not effects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from .column import Column
from .evidence import CHANNELS, STEADY, WARMING, CampaignEvidence, RecordingEvidence
from .linear_device import quiet_target_of, target_of
from .noise_law import IN_PHASE, PICKOFF, WHITE, NoiseLaw, beside_floors, fit_law, floors_heard
from .nuisance import SWITCHED
from .system import NoiseByRole, Solution, Stack, Whitener, solve

__all__ = ["PlainNoise", "first_noise", "measured_noise", "plain_noise", "remeasured", "with_repeats"]

ComplexArray = NDArray[np.complex128]
Key = tuple[str, str]
Bases = dict[Key, list[NDArray[np.float64]]]
#: by how much the noise of a recording's channel is larger than that of its kind
Excess = dict[tuple[int, str], float]
_ROUNDS = 5
#: rounds in which no kind of recording may be louder than so many times the median kind, in power
_TAMED_ROUNDS, _TAMED = 4, 10.0
#: a recording is unlike its kind beyond so many standard deviations of its chi-square; it must have this much freedom
_UNLIKE, _FEWEST_FREE = 3.0, 3.0
#: a row of which less than this is left says nothing of the noise
_LEAST_FREEDOM = 0.3
#: modes whose wave rises or decays: no line of theirs is quiet; what drives add to them, at least, over what they do to a held wave
_FALLING, _DRIVEN = ("ring_down", "ring_up"), 0.5
#: how far the drive gains may be from those of a fit without effects, sd over the largest of them
_GAIN_SHARE = 0.01
#: noise of the saturated model over that of one without effects, in power, at least: of all recordings, and of those in which nothing is
#: commanded to change, of which an effect moves but the mean, from so many squares on
_FLOOR, _STEADY_FLOOR, _FEWEST_SQUARES = 0.3, 0.75, 40
#: differences between repeated records that say how much their means differ by; as many of all channels count for one's own; rounds
_FEWEST_REPEATS, _BELIEVED_REPEATS, _REPEAT_ROUNDS = 4, 8.0, 3
#: rounds in which a model no richer than it need be tells the noise, where it leaves more than is believed, by so many sd
_LEAN_ROUNDS, _LOUDER = 2, 2.0


def first_noise(evidence: CampaignEvidence) -> dict[Key, NoiseLaw]:
    """Noise before it is known: what matters is that the frequency of a wave wanders by far more than the rest is uncertain."""
    return {
        r.noise_key(channel): NoiseLaw((1e6 if channel == "frequency" and r.is_wave else 1.0, 0.0, 0.0, 0.0))
        for r in evidence
        for channel in CHANNELS
    }


@dataclass(frozen=True)
class PlainNoise:
    """What a model without effects says.

    Parameters
    ----------
    floor : mapping
        Noise below which that of a saturated model does not fall, by role and channel.
    gains : mapping
        Drive gains that it keeps near.
    noise : mapping
        All that it leaves, by role and channel.
    """

    floor: Mapping[Key, NoiseLaw]
    gains: Mapping[str, float]
    noise: NoiseByRole


def plain_noise(evidence: CampaignEvidence, plain: Sequence[Column], angular_gain: float) -> PlainNoise:
    """Noise beside the nuisances ``plain`` alone, least where nothing was commanded to change, and the drive gains."""
    whole, quiet = target_of(evidence, angular_gain), quiet_target_of(evidence, angular_gain)
    noise, solution = _iterated(evidence, Stack(tuple(plain)), whole, quiet, {})
    floor = {key: law.floor(_FLOOR) for key, law in noise.items()}
    steady = _steady(evidence, Stack(tuple(plain)), solution, noise, quiet)
    parents = {r.role: r.parent_role for r in evidence}
    for role, channel in noise:
        if (law := steady.get((parents.get(role, role), channel))) is not None:
            floor[role, channel] = law.floor(_STEADY_FLOOR)
    gains = {name: value for name, value in solution.by_name().items() if name.startswith("G_")}
    return PlainNoise(floor, gains, noise)


def measured_noise(
    evidence: CampaignEvidence,
    saturated: Sequence[Column],
    of_rate: Sequence[Column],
    angular_gain: float,
    plain: PlainNoise | None = None,
    start: NoiseByRole | None = None,
) -> tuple[NoiseByRole, Excess]:
    """Noise by role and channel, from what the saturated model leaves at quiet and at signal lines; and recordings that are louder.

    ``of_rate``: the nuisances and the effects that depend on rate, all that a turned recording may show. The saturated model keeps near
    the drive gains of a ``plain`` one, and its noise does not fall far below that one's: a closed loop's drive answers the pick-off, noise
    and all, and with gains and read-out free against each other, as one amplitude or one axis leaves them, that law explains the noise
    itself, and the less is left the more it weighs. ``start``: the noise of nearly the same campaign.
    """
    whole, quiet = target_of(evidence, angular_gain), quiet_target_of(evidence, angular_gain)
    target, floor = whole, {} if plain is None else dict(plain.floor)
    if plain is not None:
        saturated, target, quiet = _held(saturated, plain.gains, whole, quiet)
    stack = Stack(tuple(saturated))
    noise, _ = _iterated(evidence, stack, target, quiet, floor, start)
    noise = _wandering_all_the_same(with_repeats(evidence, saturated, noise, {}, target))
    noise, excess = _raised_to_what_is_left(evidence, _solved(evidence, stack, noise, target), noise)
    return noise, _with_table(evidence, of_rate, noise, excess, whole)


def _wandering_all_the_same(noise: NoiseByRole) -> NoiseByRole:
    """A resonance that wanders does so while it is warmed, too: two or three such records, each with a swing of its own, do not tell."""
    if STEADY not in noise or WARMING not in noise:
        return noise
    _, flicker, _, walk = noise[STEADY].coefficients
    return {**noise, WARMING: noise[WARMING].not_below(NoiseLaw((0.0, flicker, 0.0, walk), noise[STEADY].mean))}


def _iterated(
    evidence: CampaignEvidence,
    stack: Stack,
    target: Sequence[ComplexArray],
    quiet: Sequence[ComplexArray],
    floor: Mapping[Key, NoiseLaw],
    start: NoiseByRole | None = None,
) -> tuple[NoiseByRole, Solution]:
    """Noise that a model leaves, and its fit with that noise; nowhere below a floor."""
    noise: NoiseByRole = first_noise(evidence) if start is None else start
    solution = _solved(evidence, stack, noise, target)
    for k in range(0 if start is None else _TAMED_ROUNDS, _TAMED_ROUNDS + _ROUNDS):
        noise = _from_residuals(evidence, stack, solution, noise, quiet)
        noise = {key: law.not_below(floor[key]) if key in floor else law for key, law in noise.items()}
        if k < _TAMED_ROUNDS:
            noise = _tamed(noise, {r.role for r in evidence if r.is_wave})
        solution = _solved(evidence, stack, noise, target)
    return noise, solution


def _held(
    columns: Sequence[Column], about: Mapping[str, float], target: Sequence[ComplexArray], quiet: Sequence[ComplexArray]
) -> tuple[list[Column], list[ComplexArray], list[ComplexArray]]:
    """Columns and targets with the drive gains known to a share, and what they explain at those values taken off."""
    gains = {c.name: about[c.name] for c in columns if c.name in about}
    sd = _GAIN_SHARE * max((abs(v) for v in gains.values()), default=0.0)
    known = [c for c in columns if c.name in gains]
    held = [replace(c, prior_sd=sd) if c.name in gains else c for c in columns]
    target = [t - sum((gains[c.name] * c.signal[k] for c in known), np.zeros_like(t)) for k, t in enumerate(target)]
    quiet = [t - sum((gains[c.name] * c.quiet[k] for c in known), np.zeros_like(t)) for k, t in enumerate(quiet)]
    return held, target, quiet


def _with_table(
    evidence: CampaignEvidence, told: Sequence[Column], noise: NoiseByRole, excess: Excess, target: Sequence[ComplexArray]
) -> Excess:
    """Excess of the turned recordings: what a table does besides its log is no effect, so only effects of rate may explain it."""
    whitener = Whitener.of(evidence, noise, excess)
    solution = solve(told, whitener.design(told, len(evidence)), whitener.rows(target))
    more = dict(excess)
    for _, r, _, _, channel, rows in _parts(evidence):
        if is_turned(r.recording):
            ratio = float(np.mean(solution.residual[rows] ** 2))
            if ratio > 1.0 + _UNLIKE * np.sqrt(2.0 / (rows.stop - rows.start)):
                more[r.index, channel] = more.get((r.index, channel), 1.0) * ratio
    return more


def _solved(
    evidence: CampaignEvidence, stack: Stack, noise: NoiseByRole, target: Sequence[ComplexArray], excess: Excess | None = None
) -> Solution:
    whitener = Whitener.of(evidence, noise, excess)
    return solve(stack.columns, whitener.rows(stack.signal), whitener.rows(target))


def _parts(evidence: CampaignEvidence) -> Iterator[tuple[int, RecordingEvidence, int, int, str, slice]]:
    """Index, recording, part (real, imaginary), side (along, across), channel, and its rows in a solution's residual."""
    first = 0
    for k, r in enumerate(evidence):
        half = r.signal.lhs.size // 2
        for part in range(2):
            for side in range(2):
                yield (
                    k,
                    r,
                    part,
                    side,
                    CHANNELS[2 * side + part],
                    slice(first + (2 * part + side) * half, first + (2 * part + side + 1) * half),
                )
        first += 4 * half


def _squares(
    evidence: CampaignEvidence,
    stack: Stack,
    solution: Solution,
    noise: NoiseByRole,
    quiet: Sequence[ComplexArray],
    wanted: Callable[[RecordingEvidence], bool] = lambda r: True,
) -> tuple[Bases, Bases]:
    """What a solution leaves at signal lines and at quiet ones, squared and corrected for its leverage, with the densities' terms there."""
    basis: Bases = defaultdict(list)
    squares: Bases = defaultdict(list)
    freedom = np.clip(1.0 - np.sum(solution.basis**2, axis=1), 1e-9, 1.0)
    whitener = Whitener.of(evidence, noise)
    left = [q - columns @ solution.values for q, columns in zip(quiet, stack.quiet, strict=True)]
    for k, r, part, side, channel, rows in _parts(evidence):
        if not wanted(r):
            continue
        key, lines = r.noise_key(channel), r.lines(channel)
        kept = freedom[rows] > _LEAST_FREEDOM
        basis[key].append(lines.basis()[kept])
        found, free = solution.residual[rows] ** 2 * noise[key].density(lines), freedom[rows]
        if any(noise[key].floors) or (r.is_wave and channel in IN_PHASE):
            # far from white: what a line has beyond what the others say is no measure of its density
            factor = whitener.channel(k, part, side)
            found, free = (factor @ solution.residual[rows]) ** 2, factor**2 @ free / np.sum(factor**2, axis=1)
        squares[key].append((found / free)[kept])
        if r.recording.command.mode in _FALLING:
            continue  # what rises or decays has something at every line
        values = np.split(left[k], 2)[side]
        basis[key].append(r.lines(channel, quiet=True).basis())
        squares[key].append((values.real if part == 0 else values.imag) ** 2)
    return basis, squares


def _from_residuals(
    evidence: CampaignEvidence, stack: Stack, solution: Solution, noise: NoiseByRole, quiet: Sequence[ComplexArray]
) -> NoiseByRole:
    basis, squares = _squares(evidence, stack, solution, noise, quiet)
    # an open drive is as steady as its generator, and where its resonance lay is a nuisance of its own: what is slow there is no noise
    steady = {r.noise_key(channel) for r in evidence if not r.is_wave for channel in CHANNELS}
    told = [key for key in basis if sum(len(s) for s in squares[key])]  # else the model follows it at every line: as it was believed
    floors = floors_heard({key: basis[key] for key in told}, squares, evidence.phase_floors)
    fitted = {}
    for key in told:
        together = np.concatenate(basis[key]), np.concatenate(squares[key])
        fitted[key] = fit_law(*together, slow=key not in steady, floors=floors[key])
    found = {key: fitted.get(key, noise[key]) for key in basis}
    found.update(beside_floors({key: law for key, law in found.items() if key not in steady and key[1] != "frequency"}))
    parents, out = {r.role: r.parent_role for r in evidence}, {}
    falling = {r.role for r in evidence if r.recording.command.mode in _FALLING}
    for (role, channel), law in found.items():
        parent = found.get((parents.get(role, role), channel), law)
        known = parent is law or sum(len(s) for s in squares[role, channel]) >= _FEWEST_SQUARES
        driven = parent.of_drives().times(_DRIVEN) if role in falling else law
        out[role, channel] = law.not_below(driven if known else parent)
    return out


def _steady(
    evidence: CampaignEvidence, stack: Stack, solution: Solution, noise: NoiseByRole, quiet: Sequence[ComplexArray]
) -> dict[Key, NoiseLaw]:
    """Noise of recordings in which nothing is commanded to change, beside their means."""
    basis, squares = _squares(evidence, stack, solution, noise, quiet, _is_steady)
    return {
        key: fit_law(np.concatenate(basis[key]), np.concatenate(squares[key]), floors=noise[key].floors)
        for key in basis
        if sum(len(s) for s in squares[key]) >= _FEWEST_SQUARES
    }


def _is_steady(r: RecordingEvidence) -> bool:
    command = r.recording.command
    changes = command.excitation.kind != "none" or command.setpoints.virtual_precession_v != 0.0 or command.mode in SWITCHED
    return r.is_wave and not (changes or r.is_warming or is_turned(r.recording))


def _tamed(noise: NoiseByRole, waves: set[str]) -> NoiseByRole:
    """Noise with white and pick-off terms near those of the other kinds of recording: one device, one pair of pick-offs.

    A kind that is believed to be loud has no say in the fit, columns that cancel one another everywhere else then miss it by
    anything, and it is loud. Only a fit that had to respect it can tell whether it is.
    """
    heard = [key for key in noise if key[0] in waves and key[1] != "frequency"]
    tamed = dict(noise)
    for term in (WHITE, PICKOFF):
        sizes = [c for key in heard if (c := noise[key].coefficients[term]) > 0.0]
        for key in heard if sizes else ():
            tamed[key] = tamed[key].at_most(term, _TAMED * float(np.median(sizes)))
    return tamed


def with_repeats(
    evidence: CampaignEvidence, columns: Sequence[Column], noise: NoiseByRole, excess: Excess, target: Sequence[ComplexArray]
) -> NoiseByRole:
    """Noise of the means, raised to what repeated records differ by beyond what a model's freedom takes of it.

    What drives and pick-offs add at a mean does not know the channel: each has its own repeats, and as many more as are believed of all.

    Parameters
    ----------
    evidence : CampaignEvidence
    columns : sequence of Column
        Of the model: with every effect at once, since what it lacks bends what follows the time, and that is where repeats differ.
    noise, excess : mapping
    target : sequence of ndarray, complex
        Left-hand sides by recording.
    """
    stack = Stack(tuple(columns))
    for _ in range(_REPEAT_ROUNDS):
        found = _repeated(evidence, _solved(evidence, stack, noise, target, excess), noise)
        weight = sum(free / density**2 for _, free, density in found.values())
        if sum(free for _, free, _ in found.values()) < _FEWEST_REPEATS or weight == 0.0:
            return noise
        of_all = sum((square - free) / density for square, free, density in found.values()) / weight
        raised = dict(noise)
        for key, (square, free, density) in found.items():
            more = ((square - free) * density + _BELIEVED_REPEATS * of_all) / (free + _BELIEVED_REPEATS)
            raised[key] = replace(noise[key], mean=max(noise[key].mean + more, 0.0))
        noise = raised
    return noise


def remeasured(
    evidence: CampaignEvidence, columns: Sequence[Column], noise: NoiseByRole, excess: Excess, angular_gain: float
) -> NoiseByRole:
    """Noise of kinds of which a model that is no richer than it need be leaves more than is believed, and of the means.

    Of a wave's frequency it stays: its walk is steep, and a model that tells its slow part by itself leaves the walk too small.

    Parameters
    ----------
    evidence : CampaignEvidence
    columns : sequence of Column
        Nuisances at their sizes, and the effects that may be there.
    noise, excess : mapping
        As the saturated model has them: of effects by the score it cannot tell a floor of a few lines, and repeats have no freedom there.
    angular_gain : float
    """
    target, quiet = target_of(evidence, angular_gain), quiet_target_of(evidence, angular_gain)
    stack = Stack(tuple(columns))
    for _ in range(_LEAN_ROUNDS):
        solution = _solved(evidence, stack, noise, target, excess)
        found = _from_residuals(evidence, stack, solution, noise, quiet)
        left = _left_at_lines(evidence, solution)
        louder = {key for key, (square, free) in left.items() if square > free + _LOUDER * np.sqrt(2.0 * free)} - {STEADY, WARMING}
        noise = {key: replace(found[key], mean=law.mean) if key in louder else law for key, law in noise.items()}
    return with_repeats(evidence, columns, noise, excess, target)


def _left_at_lines(evidence: CampaignEvidence, solution: Solution) -> dict[Key, tuple[float, float]]:
    """Of kinds that have many signal lines beside the means: the sum of squares in units of their noise, and what is expected of it."""
    freedom = np.clip(1.0 - np.sum(solution.basis**2, axis=1), 0.0, 1.0)
    left: dict[Key, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for _, r, _, _, channel, rows in _parts(evidence):
        lines = ~r.lines(channel).is_mean
        of_kind = left[r.noise_key(channel)]
        of_kind[0] += float(np.sum(solution.residual[rows][lines] ** 2))
        of_kind[1] += float(np.sum(freedom[rows][lines]))
    return {key: (square, free) for key, (square, free) in left.items() if free >= _FEWEST_SQUARES}


def _repeated(evidence: CampaignEvidence, solution: Solution, noise: NoiseByRole) -> dict[Key, tuple[float, float, float]]:
    """Of every channel: sum of squares between repeated means in units of their noise, what is expected of it, density of a mean."""
    groups: dict[tuple[object, ...], list[slice]] = defaultdict(list)
    of_group: dict[tuple[object, ...], tuple[Key, float]] = {}
    for _, r, _, _, channel, rows in _parts(evidence):
        plain = r.is_wave and not r.is_warming and not is_turned(r.recording)
        if plain and r.lines(channel).is_mean[0] and channel != "frequency":
            condition = (*r.condition, channel)
            groups[condition].append(rows)
            of_group[condition] = r.noise_key(channel), float(noise[r.noise_key(channel)].density(r.lines(channel))[0])
    found: dict[Key, tuple[float, float, float]] = {}
    for condition, members in groups.items():
        (key, density), first = of_group[condition], [rows.start for rows in members]
        left, basis = solution.residual[first], solution.basis[first]
        differing = basis - basis.mean(axis=0)
        square = float(np.sum((left - left.mean()) ** 2))
        free = max(len(first) - 1.0 - float(np.sum(differing**2)), 0.0)
        before = found.get(key, (0.0, 0.0, density))
        found[key] = (before[0] + square, before[1] + free, before[2])
    return found


def _raised_to_what_is_left(evidence: CampaignEvidence, solution: Solution, noise: NoiseByRole) -> tuple[NoiseByRole, Excess]:
    """Noise raised where even the saturated model leaves more at the signal's lines than it says: of one recording, or of its kind."""
    squares: dict[Key, float] = defaultdict(float)
    spare: dict[Key, float] = defaultdict(float)
    freedom = np.clip(1.0 - np.sum(solution.basis**2, axis=1), 0.0, 1.0)
    excess: Excess = {}
    for _, r, _, _, channel, rows in _parts(evidence):
        square, free = float(solution.residual[rows] @ solution.residual[rows]), float(freedom[rows].sum())
        if free > _FEWEST_FREE and square / free > 1.0 + _UNLIKE * np.sqrt(2.0 / free):
            excess[r.index, channel] = square / free
            square = free
        squares[r.noise_key(channel)] += square
        spare[r.noise_key(channel)] += free
    return {key: law.times(max(1.0, squares[key] / max(spare[key], 1.0))) for key, law in noise.items()}, excess
