"""The verdict of a diagnosis, in the words and keys that people and programs read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..quantity import Quantity
from .fleet import Coefficients
from .gap_map import Cell

__all__ = ["SCHEMA", "Alternative", "AsHealthy", "Diagnosis", "FoundEffect", "Gap", "NextExperiment", "Standing", "Unknown"]

#: version of the JSON
SCHEMA = 1
_MAP_CELLS = 60
#: two axes of an effect are unlike beyond so many standard deviations and this share: pick-offs alone make 6 % of a cubic one
_UNLIKE_SD, _UNLIKE = 4.0, 0.1
#: sd beyond which a rate [deg/h] and a change of the scale factor [ppm] are not told: 1000 deg/s, and all of it
_MOST = {"bias": 3.6e6, "scale": 1e6}
#: on what something unknown depends that is of some experiments and has no form
_OF_EXPERIMENTS = ("recording", "experiment")


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the recordings hold.

    Parameters
    ----------
    name : str
        Of the registry.
    title : str
        For people.
    group : tuple of str
        Itself and what these data cannot tell from it.
    probability : float
        Of the group.
    parameters : mapping of str to Quantity
        Sizes, and the setting of what is not linear.
    location : str
        dynamics, drive, pick-off, electronics, environment.
    registry_name : str
        Name of the variant in the registry, whose parameters :attr:`parameters` are: that of a device file and of ``simulate --effect``.
    gain : float
        Chi-square that it takes away.
    harmless : bool
        Present, but below what it matters: its share of bias and scale factor is under their noise.
    """

    name: str
    title: str
    group: tuple[str, ...]
    probability: float
    parameters: Mapping[str, Quantity]
    location: str
    registry_name: str
    gain: float
    harmless: bool = False

    def to_json(self) -> dict[str, Any]:
        """Keys of the contract, and more."""
        return {
            "name": self.name,
            "title": self.title,
            "group": [*self.group, *self._by_axis()],
            "probability": self.probability,
            "parameters": {name: q.to_json() for name, q in self.parameters.items()},
            "location": self.location,
            "registry_name": self.registry_name,
            "chi_square": self.gain,
            "harmless": self.harmless,
            "simulate": _simulated(self.registry_name, self.parameters),
        }

    def in_device_file(self) -> dict[str, float]:
        """Sizes as the part ``effects`` of a device file has them under :attr:`registry_name`.

        Within the registry's bounds: a noisy estimate of what cannot be negative may be just below zero.
        """
        return _within_bounds(self.registry_name, self.parameters)

    def _by_axis(self) -> list[str]:
        """The variant by axis, if the axes are less alike than a unit's pick-offs make them, or something acts across them."""
        sizes = list(self.parameters.values())
        if self.registry_name in self.group or len(sizes) < 2:
            return []
        (x, y), across = sizes[:2], [q for name, q in self.parameters.items() if name.endswith(("_s", "_xy", "_yx"))]
        unlike = [(abs(x.value - y.value), math.hypot(x.sd, y.sd)), *((abs(q.value), q.sd) for q in across)]
        least = _UNLIKE * max(abs(x.value), abs(y.value))
        return [self.registry_name] if any(by > max(_UNLIKE_SD * sd, least) for by, sd in unlike) else []


@dataclass(frozen=True)
class AsHealthy:
    """What would be an effect, were it larger than any healthy device may have it.

    Parameters
    ----------
    name, title, location : str
        Of the registry.
    parameters : mapping of str to Quantity
        Sizes, as an effect's.
    told : mapping of str to Quantity
        What is told where these are not: the difference of two axes. Empty: they are.
    gain : float
        Chi-square that it takes away.
    usual : mapping of str to float
        Standard deviations of healthy devices about zero, by the field of :class:`.healthy.HealthySpread`.
    times_usual : float
        Its largest coefficient over that.
    """

    name: str
    title: str
    location: str
    parameters: Mapping[str, Quantity]
    told: Mapping[str, Quantity]
    gain: float
    usual: Mapping[str, float]
    times_usual: float

    def to_json(self) -> dict[str, Any]:
        """Its fields, and how to simulate it."""
        return {
            "name": self.name,
            "title": self.title,
            "location": self.location,
            "parameters": {name: q.to_json() for name, q in self.parameters.items()},
            "told": {name: q.to_json() for name, q in self.told.items()},
            "chi_square": self.gain,
            "healthy_sd": dict(self.usual),
            "times_healthy_sd": self.times_usual,
            "simulate": _simulated(self.name, self.parameters),
        }


@dataclass(frozen=True)
class Unknown:
    """Something that is not in the catalogue.

    Parameters
    ----------
    location, phase, form, depends_on : str
        Of the anonymous term that closes most of what is left.
    nearest : str
        Effect of the registry that comes nearest, "" where none does.
    gain : float
        Chi-square that the term takes away.
    """

    location: str
    phase: str
    form: str
    depends_on: str
    nearest: str
    gain: float

    def words(self) -> str:
        """Where it acts and as what, for people."""
        if self.depends_on in _OF_EXPERIMENTS:
            return f"in the {self.location}: {self.form}"
        return f"in the {self.location}, {self.phase}: grows as {self.form} and depends on {self.depends_on}"

    def to_json(self) -> dict[str, Any]:
        """Its fields, null for no kin."""
        return {**asdict(self), "nearest": self.nearest or None}


@dataclass(frozen=True)
class Standing:
    """One line of the ranked table: what the recordings say of an effect.

    Parameters
    ----------
    name, title, location : str
    status : str
        ``present``, ``like <effect>``, ``excluded``, ``cannot tell``, ``not testable``.
    excluded_above : Quantity or None
        Size of its first parameter above which it would have been seen (power 90 %); None where no device would be as large.
    log_evidence, gain, absorbed : float
    """

    name: str
    title: str
    location: str
    status: str
    excluded_above: Quantity | None
    log_evidence: float
    gain: float
    absorbed: float


@dataclass(frozen=True)
class Gap:
    """How far the gap shrinks, on experiments that sizes were not found on.

    Parameters
    ----------
    rms_before, rms_after : float
        Over the noise; after: over that and over what the other experiments leave open of the sizes.
    closed_fraction : Quantity
        Of what the other experiments tell.
    bias_before, bias_after : Quantity
        Rate that the unseen experiments leave unexplained, root mean square [deg/h].
    scale_before, scale_after : Quantity
        By how much the missing effects bend the scale factor, and how well it is known with them [ppm].
    experiments : tuple of str
        Unseen experiments that improved most.
    """

    rms_before: float
    rms_after: float
    closed_fraction: Quantity
    bias_before: Quantity
    bias_after: Quantity
    scale_before: Quantity
    scale_after: Quantity
    experiments: tuple[str, ...] = ()

    def untold(self) -> frozenset[str]:
        """Which of ``bias`` and ``scale`` these recordings leave open by more than any gyro has: figures that say nothing."""
        named = {"bias": (self.bias_before, self.bias_after), "scale": (self.scale_before, self.scale_after)}
        return frozenset(name for name, pair in named.items() if not all(q.sd <= _MOST[name] for q in pair))

    def to_json(self) -> dict[str, Any]:
        """Keys of the contract."""
        return {
            "before": {"rms_over_noise": self.rms_before},
            "after": {"rms_over_noise": self.rms_after},
            "closed_fraction": self.closed_fraction.to_json(),
            "bias": {"before": self.bias_before.to_json(), "after": self.bias_after.to_json()},
            "scale_factor": {"before": self.scale_before.to_json(), "after": self.scale_after.to_json()},
            "experiments": list(self.experiments),
        }


@dataclass(frozen=True)
class Alternative:
    """A candidate experiment and what it would tell.

    Parameters
    ----------
    description : str
        What to do.
    splits : tuple of str
        Effects that it tells apart, or makes testable.
    power_per_second : float or None
        Non-centrality of the test between them that a second of it adds [1/s]; None where these recordings cannot say.
    """

    description: str
    splits: tuple[str, ...]
    power_per_second: float | None


@dataclass(frozen=True)
class NextExperiment:
    """What to record next.

    Parameters
    ----------
    description : str
        What to do.
    purpose : str
        What it decides.
    splits : tuple of str
        Effects that it tells apart, or makes testable.
    alternatives : tuple of Alternative
    """

    description: str
    purpose: str
    splits: tuple[str, ...] = ()
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class PatchedEstimate:
    """The linear device that the recordings say, with the effects taken into account.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        Slow flow about ``omega0_rad_s`` at ``temperature_degc``, the constant input rate included in A.
    omega0_rad_s, temperature_degc, frequency_slope_rad_s_k, angular_gain : float
    values : mapping of str to float
        Every unknown of the fit by name (temperature coefficients among them).
    coefficients : Coefficients or None
        Those that a healthy device has, by which a fleet tells how large they are.
    """

    A: NDArray[np.complex128]
    G: NDArray[np.complex128]
    E: NDArray[np.complex128]
    omega0_rad_s: float
    temperature_degc: float
    frequency_slope_rad_s_k: float
    angular_gain: float
    values: Mapping[str, float]
    coefficients: Coefficients | None = None


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a diagnosis says; see :func:`.diagnose.diagnose`.

    Parameters
    ----------
    device_id : str
    verdict : str
        ``none``, ``effects``, ``unknown`` or ``not_testable``.
    summary : str
        One sentence for people.
    effects, unknown, map, standings, gap, not_testable, next_experiment, warnings
        See the classes. Effects beside something unknown are those that take many times as much.
    chi2_before, chi2_after, dof : float, float, int
        Before and after the effects, all experiments.
    probability_none, probability_unknown : float
    recordings, elapsed_s : int, float
    provenance : mapping
        Version of the package, hashes of what was read.
    estimate : PatchedEstimate or None
        The linear device beside the effects: what a patched device file is made of.
    map_after : tuple of Cell
        The map once the effects are in; empty without effects.
    as_healthy : tuple of AsHealthy
        What it has that any healthy device may have: no gap, but no drawing has it.
    """

    device_id: str
    verdict: str
    summary: str
    effects: tuple[FoundEffect, ...]
    unknown: Unknown | None
    map: tuple[Cell, ...]
    standings: tuple[Standing, ...]
    gap: Gap
    not_testable: tuple[str, ...]
    next_experiment: NextExperiment
    chi2_before: float
    chi2_after: float
    dof: int
    probability_none: float
    probability_unknown: float
    recordings: int
    elapsed_s: float
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    estimate: PatchedEstimate | None = None
    map_after: tuple[Cell, ...] = ()
    as_healthy: tuple[AsHealthy, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Keys of the contract (issue: diagnose the gap), and more; plain types."""
        return {
            "schema": SCHEMA,
            "device_id": self.device_id,
            "verdict": self.verdict,
            "summary": self.summary,
            "effects": [e.to_json() for e in self.effects],
            "unknown": None if self.unknown is None else self.unknown.to_json(),
            "probability": {"none": self.probability_none, "unknown": self.probability_unknown},
            "map": [asdict(cell) for cell in self.map[:_MAP_CELLS]],
            "standings": [
                {**asdict(s), "excluded_above": None if s.excluded_above is None else s.excluded_above.to_json()} for s in self.standings
            ],
            "as_healthy": [held.to_json() for held in self.as_healthy],
            "gap": self.gap.to_json(),
            "not_testable": list(self.not_testable),
            "next_experiment": asdict(self.next_experiment),
            "chi_square": {"before": self.chi2_before, "after": self.chi2_after, "dof": self.dof},
            "recordings": self.recordings,
            "elapsed_s": self.elapsed_s,
            "warnings": list(self.warnings),
            "provenance": dict(self.provenance),
        }


def _within_bounds(registry_name: str, parameters: Mapping[str, Quantity]) -> dict[str, float]:
    known = {p.name: p for p in EFFECTS[registry_name].parameters}
    return {name: min(max(q.value, known[name].lower), known[name].upper) for name, q in parameters.items() if name in known}


def _simulated(registry_name: str, parameters: Mapping[str, Quantity]) -> list[str]:
    """Sizes as ``gyro-calib simulate --effect`` takes them, word for word."""
    return [f"{registry_name}.{name}={value!r}" for name, value in _within_bounds(registry_name, parameters).items()]
