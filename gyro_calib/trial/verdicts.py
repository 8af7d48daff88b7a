"""What a diagnosis said, in plain types: what is scored, kept and sent between processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ..gap import Diagnosis

__all__ = ["Found", "Verdict"]


@dataclass(frozen=True)
class Found:
    """An effect that was named.

    Parameters
    ----------
    name, registry_name : str
    group : tuple of str
        With what the data cannot tell from it.
    probability : float
    parameters : mapping of str to (float, float)
        Value and standard deviation.
    gain : float
        Chi-square that it takes away.
    """

    name: str
    registry_name: str
    group: tuple[str, ...]
    probability: float
    parameters: Mapping[str, tuple[float, float]]
    gain: float


@dataclass(frozen=True)
class Verdict:
    """A diagnosis, or why there is none.

    Parameters
    ----------
    verdict : str
        ``none``, ``effects``, ``unknown``, ``not_testable``; ``failed`` when the diagnosis raised.
    effects : tuple of Found
    unknown : mapping or None
    rms_before, rms_after : float
        On unseen experiments, over the noise.
    closed, closed_sd : float
        Closed fraction there.
    probability_none, probability_unknown : float
    not_testable : tuple of str
    chi2_after, dof : float
    elapsed_s : float
    error : str
    extra : mapping
        What else the diagnosis says of itself.
    """

    verdict: str
    effects: tuple[Found, ...] = ()
    unknown: Mapping[str, Any] | None = None
    rms_before: float = 1.0
    rms_after: float = 1.0
    closed: float = 0.0
    closed_sd: float = 0.0
    probability_none: float = 0.0
    probability_unknown: float = 0.0
    not_testable: tuple[str, ...] = ()
    chi2_after: float = 0.0
    dof: float = 1.0
    elapsed_s: float = 0.0
    error: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> Verdict:
        """What is scored of a diagnosis."""
        gap = diagnosis.gap
        return cls(
            verdict=diagnosis.verdict,
            effects=tuple(
                Found(
                    name=e.name,
                    registry_name=e.registry_name,
                    group=tuple(e.group),
                    probability=float(e.probability),
                    parameters={k: (float(q.value), float(q.sd)) for k, q in e.parameters.items()},
                    gain=float(e.gain),
                )
                for e in diagnosis.effects
            ),
            unknown=None if diagnosis.unknown is None else asdict(diagnosis.unknown),
            rms_before=float(gap.rms_before),
            rms_after=float(gap.rms_after),
            closed=float(gap.closed_fraction.value),
            closed_sd=float(gap.closed_fraction.sd),
            probability_none=float(diagnosis.probability_none),
            probability_unknown=float(diagnosis.probability_unknown),
            not_testable=tuple(diagnosis.not_testable),
            chi2_after=float(diagnosis.chi2_after),
            dof=float(diagnosis.dof),
            elapsed_s=float(diagnosis.elapsed_s),
        )

    @property
    def found_something(self) -> bool:
        """Whether a gap was reported, named or not."""
        return self.verdict in ("effects", "unknown")

    def to_json(self) -> dict[str, Any]:
        """Plain types."""
        return asdict(self)
