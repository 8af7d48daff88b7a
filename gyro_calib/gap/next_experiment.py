"""What to record next: to tell apart what these data cannot, or to make testable what they do not vary."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..effects import EFFECTS
from ..recording.applied_rate import is_turned
from .diagnosis import Alternative, NextExperiment, Standing, Unknown
from .evidence import RecordingEvidence
from .model import CampaignModel
from .select import Selection

__all__ = ["experiment_for", "next_experiment"]

#: what to do so that recordings vary what an effect needs
_RECIPES = {
    "temperature": "Repeat the static recordings on both axes with the temperature ramped by 10 K and held",
    "rate": "Repeat a static recording on a rate table with steps of 10, 30 and 60 deg/s of both signs",
    "rates": "Repeat a recording on the rate table with steps of both signs of a third of the usual rate and of twice as much",
    "amplitudes": "Repeat the recordings at two further amplitudes, a third lower and a third higher",
    "large drive": "Record virtual precession or a ring-up at twice the drive",
    "open drive": "Record open drive of each axis at +-20 and +-60 Hz from resonance, loops off",
    "side bands": "Record side bands at 0.1, 0.5, 1 and 1.5 Hz on both axes",
    "time": "Repeat the first static recordings at the end, and once more after an hour",
    "azimuth": "Record virtual precession of both senses over whole turns",
}
#: the same of a gyro whose wave is never turned
_REBALANCED = {"large drive": "Record side bands at 1.5 Hz with twice the index, and open drive of each axis at twice the voltage"}
#: what shows the form of something without a name, by what it depends on
_OF_UNKNOWN = {
    "amplitude": "Repeat the static recordings of both axes at five amplitudes, from a third of the usual one to the largest of the loops",
    "azimuth": "Record virtual precession of both senses over three whole turns at two more amplitudes",
    "drive": "Repeat the recordings with the largest drive at three more voltages, the amplitude held",
    "drive's power": "Go from the smallest amplitude or precession to the largest and back, recording from that moment on for a minute",
    "temperature": "Step the temperature by 10 K, up and down, and record both axes while it moves and until nothing changes any more",
    "time": "Record one static recording as long as the whole campaign, with nothing commanded meanwhile",
    "rate": "Record constant rates of 10, 30 and 60 deg/s of both signs, each on both axes",
    "speed of change": "Record side bands of one amplitude from 0.05 to 5 Hz on both axes",
    "frequency": "Record open drive of each axis at twenty distances between 2 and 200 Hz on both sides of the resonance",
    "phase reference": "Repeat the static recordings with the wave at other azimuths",
    "reference": "Record both axes with the loops off and the drives taken from their electrodes: what is still read is no motion",
    "recording": "Record the recording that stands out again, and one of another kind before and after it",
    "experiment": "Repeat the experiments in another order: what comes again is of the experiment, what does not is of the time",
}
#: non-centrality at which two effects are told apart (gap.md: SNR times sine of the angle of 5); repeats beyond this are no plan
_APART, _MOST_REPEATS = 25.0, 100.0
_TEMPERATURE_K, _AMPLITUDES, _TURN_RAD = 2.0, 1.3, 2.0 * np.pi
#: shares of the largest rate between which a table's is another, and the share of its time that makes it so: a motor passes by in 1 %
_ANOTHER_RATE, _ITS_TIME = (0.1, 0.8), 0.05
#: largest drive over the usual one of a held wave from which on it was large
_LARGE = 3.0


def _varied(model: CampaignModel) -> set[str]:
    """What the recordings vary already."""
    records = [r.recording for r in model.evidence]
    waves = [r for r in model.evidence if r.is_wave]
    amplitudes = [r.mean_square for r in waves]
    found = {
        "temperature": np.ptp([float(r.signals.temperature_k.mean()) for r in model.evidence]) > _TEMPERATURE_K
        or any(r.is_warming for r in model.evidence),
        "rate": any(is_turned(r) for r in records),
        "rates": _of_several_rates(
            np.concatenate([r.signals.rate_rad_s for r in model.evidence if is_turned(r.recording)] or [np.zeros(1)])
        ),
        "amplitudes": max(amplitudes) > _AMPLITUDES * min(amplitudes),
        "open drive": any(r.command.excitation.kind == "drive" for r in records),
        "side bands": any(r.command.excitation.kind.endswith("modulation") for r in records),
        # a gyro that is rebalanced has no wave to be turned
        "azimuth": any(r.signal.turn_rad > _TURN_RAD for r in model.evidence) or not _may_turn(model),
        "large drive": max(_volts(r) for r in model.evidence) > _LARGE * float(np.median([_volts(r) for r in waves])),
    }
    return {name for name, yes in found.items() if yes}


def _of_several_rates(rate_rad_s: np.ndarray) -> bool:
    """Whether a table turned at more than one speed: of one, an excess that grows with the rate is one of the angular gain."""
    size = np.abs(rate_rad_s)
    low, high = (share * float(size.max()) for share in _ANOTHER_RATE)
    turning = size > low
    return bool(np.mean(size[turning] < high) > _ITS_TIME) if np.any(turning) else False


def _may_turn(model: CampaignModel) -> bool:
    return any(r.recording.command.mode == "whole_angle" for r in model.evidence)


def _volts(r: RecordingEvidence) -> float:
    """Of both drives, root mean square."""
    return float(np.sqrt(np.mean(np.sum(np.abs(r.signals.drive) ** 2, axis=1))))


def _recipe(model: CampaignModel, need: str) -> str:
    return _REBALANCED[need] if need in _REBALANCED and not _may_turn(model) else _RECIPES[need]


def _repeats(model: CampaignModel, selection: Selection) -> list[Alternative]:
    """Recordings of this campaign that tell a group's effects apart, by what each adds per second of it, and how often to repeat it.

    What one effect shows and another in its place cannot imitate is a vector over all equations; its squared length is the
    non-centrality of the test between the two, and a recording's share of it over its duration is what a second of it is worth (gap.md 8).
    """
    worth: dict[str, tuple[float, float, tuple[str, ...]]] = {}
    for k, group in enumerate(selection.groups):
        chosen = [e.candidate for e in selection.effects]
        screener = model.screener_with([c for j, c in enumerate(chosen) if j != k])
        mine = screener.screen(chosen[k])
        for other in group[1:]:
            rivals = screener.screened(model.candidates.get(other, ()))
            if mine is None or not rivals:
                continue
            shown = mine.directions @ (mine.directions.T @ screener.left)
            rival = max(rivals, key=lambda s: s.gain)
            apart = shown - rival.directions @ (rival.directions.T @ shown)
            found = _by_recording(model, apart)
            best = max(found, key=lambda label: found[label][0] / found[label][1])
            power, duration = found[best]
            missing = max(_APART - float(apart @ apart), 0.0)
            if power > 0.0 and (best not in worth or missing / power > worth[best][0]):
                worth[best] = (missing / power, duration, tuple(dict.fromkeys((chosen[k].name, other))))
    out = []
    for label, (times, duration, names) in worth.items():
        if 0.0 < times <= _MOST_REPEATS:
            count = max(1, math.ceil(times))
            text = f"Repeat {label!r} {count} times ({count * duration:.0f} s): of what was recorded it tells {' from '.join(names)} best."
            out.append(Alternative(text, names, _APART / (times * duration)))
    return sorted(out, key=lambda a: -(a.power_per_second or 0.0))


def _by_recording(model: CampaignModel, rows: np.ndarray) -> dict[str, tuple[float, float]]:
    """Squared length in each recording's equations, and its duration [s]."""
    found, first = {}, 0
    for r in model.evidence:
        count = 2 * r.signal.lhs.size
        part = rows[first : first + count]
        found[r.recording.label] = (float(part @ part), r.recording.duration_s)
        first += count
    return found


def experiment_for(unknown: Unknown) -> NextExperiment:
    """What shows the form of something without a name: what it depends on is varied further."""
    steady = Alternative(_OF_UNKNOWN["time"] + ".", (), None)
    others = (steady,) if unknown.depends_on != "time" else ()
    return NextExperiment(_OF_UNKNOWN[unknown.depends_on] + ".", "find the form of what has no name", (), others)


def next_experiment(model: CampaignModel, selection: Selection, lines: Sequence[Standing]) -> NextExperiment:
    """The recipe that serves most of the effects that are alike or untestable, of what was not varied yet."""
    doubtful = tuple(dict.fromkeys(name for group in selection.groups if len(group) > 1 for name in group))
    served = doubtful or tuple(s.name for s in lines if s.status in ("not testable", "cannot tell"))
    purpose = f"tell apart {', '.join(doubtful)}" if doubtful else "see or exclude what these recordings cannot"
    repeats = _repeats(model, selection)
    varied = _varied(model)
    votes: dict[str, list[str]] = {}
    for name in served:
        for need in EFFECTS[name].needs:
            if need in _RECIPES and need not in varied:
                votes.setdefault(need, []).append(name)
    if votes:
        ranked = sorted(votes.items(), key=lambda item: -len(item[1]))
        others = tuple(Alternative(_recipe(model, need) + ".", tuple(names), None) for need, names in ranked[1:4])
        return NextExperiment(_recipe(model, ranked[0][0]) + ".", purpose, tuple(ranked[0][1]), (*repeats[:1], *others))
    if repeats:
        return NextExperiment(repeats[0].description, purpose, repeats[0].splits, tuple(repeats[1:3]))
    if served:
        return NextExperiment(
            "Repeat the campaign with recordings four times as long, in another order: everything is varied, what is missing is precision.",
            purpose,
            served,
        )
    return NextExperiment("Nothing further is needed: repeat the campaign after some months, or after a change.", "watch for ageing")
