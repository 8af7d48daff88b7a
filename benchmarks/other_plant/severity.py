"""How strong an effect is: the root of its non-centrality in the equations of the slow flow, and the size for a wanted strength."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from campaign import Recording, run
from effect import Effect, Shape
from kernel import Array
from plan import Step
from slowflow import CArray, Table, design, real_form, tabulate
from unit import Unit

HOW = (
    "sqrt of the sum of squares, over probes of every recording (means over bins of about 1 s, lines of the side bands, means of open "
    "drives), of what the effect changes in the slow flow between two runs without fast noise but with the same slow wander, in "
    "units of the noise of that sort of probe in a noisy healthy run of the unit (and, without --fast-noise-only, of its gains' 1/f), "
    "after projecting out free A, G, E, latency, shaker and isotropic temperature coefficients"
)


class Whitener:
    """Divides rows by their noise; neighbouring bins share the error of the reading between them, with opposite signs."""

    def __init__(self, table: Table, scatter: Array, floor: Array, common: list[Array]) -> None:
        self._rows: list[tuple[Array, int, Array]] = []
        first = np.r_[True, np.diff(table.record) != 0]
        for sort in np.unique(table.sort):
            here = np.flatnonzero(table.sort == sort)
            pairs = here[1:][(np.diff(here) == 1) & ~first[here[1:]]]
            for c in range(4):
                total = (1.4826 * np.median(np.abs(scatter[here, c]))) ** 2
                shared = 0.0
                if sort in ("bin", "turning", "moved") and len(pairs) > 8:
                    shared = min(
                        max(-float(np.mean(np.clip(scatter[pairs, c] * scatter[pairs - 1, c], -9 * total, 9 * total))), 0.0), 0.49 * total
                    )
                for i in np.unique(table.record[here]):
                    rows = here[table.record[here] == i]
                    n = len(rows)
                    cov = (total - 2.0 * shared) * np.eye(n) + shared * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
                    cov += np.diag(floor[rows, c] ** 2) + sum(np.outer(f[rows, c], f[rows, c]) for f in common)
                    self._rows.append((rows, c, np.linalg.cholesky(cov)))
        self._n = len(table.left)

    def __call__(self, m: Array) -> Array:
        """Whiten rows of shape (4 n, k)."""
        x = m.reshape(self._n, 4, -1)
        out = np.empty_like(x)
        for rows, c, chol in self._rows:
            out[rows, c] = np.linalg.solve(chol, x[rows, c])
        return out.reshape(m.shape)


@dataclass
class Ruler:
    """Measures the strength of effects on one unit and plan.

    Parameters
    ----------
    unit : Unit
    steps : list of Step
    seed : int
    wander : bool
        Count the 1/f of the gains as noise too. The batch of seed 7 was made without.
    """

    unit: Unit
    steps: list[Step]
    seed: int
    wander: bool = True

    def __post_init__(self) -> None:
        self._free = run(self.unit, self.steps, self.seed, noise=False)
        self._noisy = run(self.unit, self.steps, self.seed)
        self._cache: dict[float, tuple[Table, CArray, Whitener, Array, Array]] = {}

    def _tab(self, recordings: list[Recording], extra: float) -> Table:
        return tabulate(recordings, self.unit.f0, self.unit.kappa, extra)

    def _base(self, extra: float) -> tuple[Table, CArray, Whitener, Array, Array]:
        if extra not in self._cache:
            table, noisy = self._tab(self._free, extra), self._tab(self._noisy, extra)
            x = design(table)
            # what moves carries the thermometer's lag and the table's lateness, which this small model does not have
            calm = np.where(table.sort == "moved", 1e-3, np.where(table.sort == "off", 1e-2, 1.0))[:, None] * np.ones(4)
            unknown = solve(table, x, calm)
            scatter = real_form(table, noisy.left - design(noisy) @ unknown) - real_form(table, table.left - x @ unknown)
            white = Whitener(table, scatter, self._floor(table), self._common(table) if self.wander else [])
            q = _basis(white(_real_columns(table, x)))
            self._cache[extra] = table, unknown, white, q, real_form(table, table.left - x @ unknown)
        return self._cache[extra]

    def _floor(self, table: Table) -> Array:
        """What wanders slowly, and what the first order of averaging leaves of an open drive: not in the scatter of a noisy run."""
        size = np.linalg.norm(table.terms["p"], axis=1)[:, None]
        frequency = abs(self.unit.tc["frequency"]) * self.unit.w0 * 2e-4
        loss = 2.5e-6 / self.unit.tau
        floor = size * np.array([loss, frequency, loss, loss])
        open_floor = 1e-4 * np.linalg.norm(table.terms["u"], axis=1)[:, None] * self.unit.gain * np.ones(4)
        return np.asarray(np.where((table.sort == "off")[:, None], open_floor, floor))

    def _common(self, table: Table) -> list[Array]:
        """What the 1/f of a drive channel's gain adds to every probe of a recording alike, for each channel."""
        out = []
        for axis in range(2):
            force = np.zeros_like(table.left)
            force[:, axis] = -1j * self.unit.gain * table.terms["u"][:, axis]
            out.append(math.sqrt(2.0) * self.unit.wander["gain"] * real_form(table, force))
        return out

    def trace(self, effect: Effect, size: float, shape: Shape) -> Array:
        """What an effect leaves in the equations, in units of their noise."""
        extra = float(shape.get("offset_hz", 0.0))
        _, unknown, white, q, healthy = self._base(extra)
        ill = run(self.unit, self.steps, self.seed, lambda scene: effect.apply(scene, size, shape), noise=False)
        other = self._tab(ill, extra)
        moved = real_form(other, other.left - design(other) @ unknown) - healthy
        e = white(moved.reshape(-1, 1))[:, 0]
        return np.asarray(e - q @ (q.T @ e))

    def snr(self, effect: Effect, size: float, shape: Shape) -> float:
        """Strength of an effect of a size."""
        return float(np.linalg.norm(self.trace(effect, size, shape)))

    def find(self, effect: Effect, shape: Shape, wanted: float, of: tuple[float, float]) -> tuple[float, float] | None:
        """Size for a wanted strength, and the strength that it has; None if none near the range ``of`` can be had."""
        size = effect.probe(self.unit)
        first, best = size, None
        for _ in range(6):
            snr = self.snr(effect, size, shape)
            if not math.isfinite(snr):
                return None
            ratio = wanted / max(snr, 1e-3)
            if best is None or abs(math.log(ratio)) < abs(math.log(wanted / max(best[1], 1e-3))):
                best = size, snr
            if 1 / 1.15 < ratio < 1.15:
                break
            size *= min(max(ratio ** (1.0 / effect.power), 1e-4), 30.0)
            if size / first > 1e4:
                break
        return best if best is not None and of[0] / 1.07 < best[1] < 1.1 * of[1] else None


def _real_columns(table: Table, x: CArray) -> Array:
    """Real and imaginary part of every unknown as columns, shape (4 n, 2 k)."""
    a, b = real_form(table, x), real_form(table, 1j * x)
    both = np.concatenate([a, b], -1)
    return both.reshape(-1, both.shape[-1])


def solve(table: Table, x: CArray, weight: Array) -> CArray:
    """Constants of the linear model by weighted least squares."""
    m = _real_columns(table, x) * weight.ravel()[:, None]
    y = real_form(table, table.left).ravel() * weight.ravel()
    scale = np.linalg.norm(m, axis=0)
    scale[scale == 0.0] = np.inf
    sol = np.linalg.lstsq(m / scale, y, rcond=1e-12)[0] / scale
    k = x.shape[-1]
    return np.asarray(sol[:k] + 1j * sol[k:])


def _basis(m: Array) -> Array:
    norm = np.linalg.norm(m, axis=0)
    u, s, _ = np.linalg.svd(m[:, norm > 0] / norm[norm > 0], full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])
