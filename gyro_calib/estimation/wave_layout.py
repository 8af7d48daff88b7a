"""Which unknowns a whole-angle regression has, in which order, and their regressors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import applied_rate, is_turned
from ..recording.recording import Recording
from .wave_projection import WaveProjected
from .wave_terms import Term

__all__ = ["Layout"]

ComplexArray = NDArray[np.complex128]
#: ratio of the farthest to the nearest open drive from which on a feedthrough and a resonance that moved look different
_APART = 2.5
#: recordings, and spread of their temperatures [K], from which on A and G may follow it
_LEAST_WARM, _LEAST_SPREAD_K = 6, 1e-6


@dataclass(frozen=True)
class Layout:
    """Complex unknowns, in order: per axis a (A_ax, A_ay, G~_ax, G~_ay, E_ax, E_ay, body …), then as far as they are sought the response to
    rate (xx, xy, yx, yy), then the nuisances: the force that does not follow the wave (2), the lag of the drives behind their record times
    minus the mean gain (1),
    the change of E with frequency over the resonance's (4), the shift of the resonance while the drives were open (1),
    the time shift of the table (4), how A and the gain follow the temperature (2), and A its change (1); last the cubic terms.

    Parameters
    ----------
    omega0_rad_s : float
    has_feedthrough : bool
        Open drive was recorded: E is an unknown.
    bodies : tuple of float
        Frequencies of body excitation [Hz].
    turned : bool
        A rate was applied.
    picked_up : bool
        A wave turned by half a turn of psi or more: a force at the reference frequency that does not turn with it (pick-up of the
        reference by
        the forcers) shows, and would pass for damping of a wave that stands.
    lagging : bool
        Drives changed, or the wave turned under them: a record that is a sample early or late shows (and would pass for feedthrough).
    jerked : bool
        It changed during a recording.
    dispersive : bool
        Open drive at two or more distances from resonance: a feedthrough that follows the frequency (a capacitor's, a converter's delay)
        shows, and would bend E if it were left out.
    shifted : bool
        Those distances differ in size: a resonance that had moved while the drives were open (all of those records share that) shows.
    warmed : bool
        The temperature differed between the recordings: how A and G follow it are unknowns, or its wander would be noise that lasts as
        long as a recording.
    warming : bool
        It also changed within recordings: a thermometer that is late shows.
    terms : tuple of Term
    """

    omega0_rad_s: float
    has_feedthrough: bool
    bodies: tuple[float, ...] = ()
    turned: bool = False
    picked_up: bool = False
    lagging: bool = False
    jerked: bool = False
    dispersive: bool = False
    shifted: bool = False
    warmed: bool = False
    warming: bool = False
    terms: tuple[Term, ...] = ()

    @classmethod
    def of(cls, recordings: Sequence[Recording], omega0_rad_s: float, turn_rad: float) -> Layout:
        """What these recordings can determine; ``turn_rad`` is the farthest that a wave turned in one of them."""
        open_drive = [r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "drive"]
        away = [abs(f - omega0_rad_s / (2.0 * np.pi)) for f in open_drive]
        turned = [r for r in recordings if is_turned(r)]
        warmed = len(recordings) >= _LEAST_WARM and _spread_k(recordings) > _LEAST_SPREAD_K
        return cls(
            omega0_rad_s=omega0_rad_s,
            has_feedthrough=bool(open_drive),
            bodies=tuple(sorted({r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "body"})),
            turned=bool(turned),
            picked_up=turn_rad > np.pi,
            lagging=any(r.command.mode != "loops_off" for r in recordings) and (bool(open_drive) or turn_rad > np.pi),
            jerked=any(_changes(r) for r in turned),
            dispersive=len({round(f, 3) for f in open_drive}) > 1,
            shifted=bool(away) and max(away) > _APART * min(away),
            warmed=warmed,
            warming=warmed and any(np.ptp(r.temperature_degc) > _LEAST_SPREAD_K for r in recordings),
        )

    @property
    def per_axis(self) -> int:
        """Complex unknowns of one axis of the flow."""
        return 4 + 2 * int(self.has_feedthrough) + len(self.bodies)

    @property
    def rate_response(self) -> slice:
        """Place of the response to rate."""
        first = 2 * self.per_axis
        return slice(first, first + 4 * int(self.turned))

    @property
    def lag(self) -> slice:
        """Place of the lag of the drives times minus the mean gain."""
        first = self.rate_response.stop + 2 * int(self.picked_up)
        return slice(first, first + int(self.lagging))

    def term(self, name: str) -> slice:
        """Place of a cubic term.

        Raises
        ------
        KeyError
            The layout has no term of that name.
        """
        first = self.lag.stop + 4 * int(self.dispersive) + int(self.shifted) + 4 * int(self.jerked) + self._warm_columns
        for term in self.terms:
            if term.name == name:
                return slice(first, first + len(term.coefficients))
            first += len(term.coefficients)
        raise KeyError(name)

    @property
    def _warm_columns(self) -> int:
        return 2 * int(self.warmed) + int(self.warming)

    def flow(self, coefficients: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """A and E, shape (2, 2) each (E zero when it is not an unknown)."""
        block = coefficients[: 2 * self.per_axis].reshape(2, -1)
        return block[:, :2], block[:, 4:6] if self.has_feedthrough else np.zeros((2, 2), dtype=complex)

    def regressors(self, p: WaveProjected, recording: Recording, before: ComplexArray | None) -> ComplexArray:
        """Columns in order, shape (equations, unknowns); the unknowns of a round ``before`` enter the small corrections."""
        count = p.lhs.size
        excitation = recording.command.excitation
        A, E, bend = self._known(before)
        parts: list[ComplexArray] = []
        for a in range(2):
            parts += [p.pick[:, a], p.drive[:, a]]
            if self.has_feedthrough:
                parts.append(p.drive_rate[:, a])
            parts += [(p.body[:, a] * (excitation.kind == "body" and excitation.frequency_hz == f))[:, None] for f in self.bodies]
        if self.turned:
            # rate acts on the motion: on V less its feedthrough and what the pick-off adds of its own
            moved = (
                p.rate_pick
                - np.einsum("jac,bc->jab", p.rate_drive, E)
                - bend * p.terms["rate_every_axis"].reshape(count, 2, 2).swapaxes(1, 2)
            )
            parts.append(moved.reshape(count, 4))
        if self.picked_up:
            parts.append((0.0 if recording.command.mode == "loops_off" else 1.0) * p.constant)
        if self.lagging:
            # open drive is steady: nothing there tells its lag
            # a late drive pushes where it always does: along its own column of G
            late = np.einsum("jab,ab->j", p.drive_slope, self._directions(before))[:, None]
            parts.append((0.0 if recording.command.mode == "loops_off" else 1.0) * late)
        if self.dispersive:
            away = 0.0
            if excitation.kind == "drive":
                away = 2.0 * np.pi * excitation.frequency_hz / self.omega0_rad_s - 1.0
            parts.append(away * p.drive_rate.reshape(count, 4))
        if self.shifted:
            parts.append((1j if excitation.kind == "drive" else 0.0) * p.resonance[:, :1])
        if self.jerked:
            parts.append(p.jerk.reshape(count, 4))
        if self.warmed:
            moved = p.terms["warm"][:, 0] - np.einsum("jab,ab->j", _by_axes(p.terms["warm_drive"]), E)
            pushed = np.einsum("jab,ab->j", _by_axes(p.terms["warm_drive"]), self._directions(before))
            parts.append(np.column_stack([moved, pushed]))
        if self.warming:
            parts.append(p.terms["warm"][:, 1:])
        parts += [term.columns(p.terms, A) for term in self.terms]
        return np.hstack(parts)

    def pushed(self, p: WaveProjected, before: ComplexArray | None) -> ComplexArray:
        """``-i G u`` of a round before, shape (equations,): what a gain that is a little off adds, as a recording's own real unknown."""
        if before is None:
            return np.asarray(1e-12 * p.drive[:, 0, 0])
        A, E = self.flow(before)
        G = before[: 2 * self.per_axis].reshape(2, -1)[:, 2:4] + A @ E
        return np.asarray(-1j * np.einsum("jab,ab->j", p.drive, G))

    def _directions(self, before: ComplexArray | None) -> ComplexArray:
        """G over its mean size; of perfect drives without a round before."""
        if before is None:
            return np.asarray(-1j * np.eye(2), dtype=np.complex128)
        A, E = self.flow(before)
        G = before[: 2 * self.per_axis].reshape(2, -1)[:, 2:4] + A @ E
        return np.asarray(G / np.abs(np.diag(G)).mean())

    def _known(self, before: ComplexArray | None) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """A, E and the cubic coefficients of the pick-offs from a round before; zero without one."""
        bend = np.zeros(2, dtype=complex)
        if before is None:
            return np.zeros((2, 2), dtype=complex), np.zeros((2, 2), dtype=complex), bend
        if any(term.name == "pickoff_cubic" for term in self.terms):
            bend = before[self.term("pickoff_cubic")]
        return *self.flow(before), bend


def _by_axes(values: ComplexArray) -> ComplexArray:
    """Signals (x on x, x on y, y on x, y on y) as [equation, axis a, column b]."""
    return np.asarray(values.reshape(-1, 2, 2).swapaxes(1, 2))


def _spread_k(recordings: Sequence[Recording]) -> float:
    return float(np.std([r.temperature_degc.mean() for r in recordings]))


def _changes(recording: Recording) -> bool:
    return bool(np.any(applied_rate(recording)[1] != 0.0))
