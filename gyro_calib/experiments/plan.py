"""A plan: the steps of a calibration, each a command with its duration; what it needs and when it must stop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import DataError
from ..recording.command import Command

__all__ = ["Limits", "Plan", "Step"]


@dataclass(frozen=True)
class Step:
    """Record ``duration_s`` under ``command`` after ``settle_s``; ``label`` names the recording.

    With ``detuning_hz`` the excitation's frequency is the resonance as last measured (the reference frequency of the latest closed-loop
    recording) plus this; units differ by more than the distance at which an open drive must stay from resonance.

    ``applied_rate`` is how a rate table turns the gyro meanwhile (:mod:`gyro_calib.recording.applied_rate`), ``raw_s`` for how long, at the
    end of the step, converter samples are kept, ``temperature_degc`` where a chamber takes it while it settles and keeps it from then
    on (with ``temperature_ramp_s``: evenly in the first so many seconds of the record instead); an instrument says in its ``abilities``
    whether it can.

    A step that is not ``kept`` only brings the gyro where the next one needs it: its recording is not part of the campaign.
    """

    label: str
    command: Command
    duration_s: float
    settle_s: float = 1.0
    detuning_hz: float | None = None
    applied_rate: Mapping[str, Any] | None = None
    raw_s: float = 0.0
    temperature_degc: float | None = None
    temperature_ramp_s: float = 0.0
    kept: bool = True

    def __post_init__(self) -> None:
        if not self.duration_s > 0 or self.settle_s < 0:
            raise DataError(f"Step duration_s must be > 0 and settle_s >= 0, but got {self.duration_s!r}, {self.settle_s!r}.")
        if not 0.0 <= self.raw_s <= self.duration_s:
            raise DataError(f"Step raw_s must lie within 0 and duration_s = {self.duration_s:g}, but got {self.raw_s!r}.")
        if not 0.0 <= self.temperature_ramp_s <= (0.0 if self.temperature_degc is None else self.duration_s):
            raise DataError(
                f"Step temperature_ramp_s must lie within 0 and duration_s = {self.duration_s:g} and have a temperature_degc, "
                f"but got {self.temperature_ramp_s!r}."
            )

    @property
    def needs(self) -> frozenset[str]:
        """Abilities that the step asks of an instrument."""
        asked = {"applied_rate": self.applied_rate, "raw": self.raw_s > 0.0, "temperature": self.temperature_degc is not None}
        return frozenset(name for name, wanted in asked.items() if wanted)


@dataclass(frozen=True)
class Limits:
    """Abort conditions of a run.

    Parameters
    ----------
    temperature_k : float
        Largest temperature excursion since the start of the run [K].
    base_rate_rad_s : float
        Largest change of the raw rate between static stretches, and of its slow part inside one [rad/s].
    """

    temperature_k: float = 2.0
    base_rate_rad_s: float = 0.01


@dataclass(frozen=True)
class Plan:
    """Ordered steps of one method with abort conditions.

    Parameters
    ----------
    name : str
        Of the method.
    steps : tuple of Step
        In order.
    limits : Limits
        When to abort.
    final : Command
        Put in force when the plan ends, however it ends.
    words : mapping
        What every recording carries among its attributes (how an order was drawn).
    left_out : tuple of str
        In sentences, what the plan would hold on an instrument of more abilities.
    """

    name: str
    steps: tuple[Step, ...]
    limits: Limits = field(default_factory=Limits)
    final: Command = field(default_factory=Command)
    words: Mapping[str, Any] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Device time that the plan takes [s]."""
        return sum(s.duration_s + s.settle_s for s in self.steps)

    def with_compensation(
        self,
        matrix: tuple[float, float, float, float],
        *,
        final: tuple[float, float, float, float] | None = None,
        suffix: str = "",
    ) -> Plan:
        """The same plan with a drive compensation (row-major) in force in every step, and ``final`` in force when it ends.

        Parameters
        ----------
        matrix : tuple of 4 float
            During the steps.
        final : tuple of 4 float, optional
            Afterwards, however the plan ends (default: ``matrix``).
        suffix : str
            Appended to the labels.
        """
        steps = tuple(replace(s, label=s.label + suffix, command=replace(s.command, compensation=matrix)) for s in self.steps)
        return replace(self, steps=steps, final=replace(self.final, compensation=matrix if final is None else final))
