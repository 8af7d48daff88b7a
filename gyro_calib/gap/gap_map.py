"""Where the gap lies: experiment x channel x quadrature x line, in units of the measured noise, with its share of the total.

Each cell's residual is taken as if its experiment had not been fitted (left out one at a time): least squares smears an error over innocent
cells, and what an experiment leaves of its own prediction is larger than what it leaves after being fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .evidence import RecordingEvidence
from .model import CampaignModel
from .system import Solution

__all__ = ["Cell", "gap_map"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """One place of the gap.

    Parameters
    ----------
    experiment : str
        Label of the recording.
    channel : str
        ``amplitude`` and ``frequency`` along the wave, ``precession`` and ``quadrature`` across it; with the loops off the pick-off's axis.
    quadrature : str
        ``"in phase with velocity"`` or ``"in phase with displacement"``.
    feature : str
        Mean, side band, or line.
    share : float
        Of the squared gap of the whole campaign.
    z : float
        In units of noise; with two components their root sum of squares.
    left_out : float
        The same, predicted from the other experiments.
    """

    experiment: str
    channel: str
    quadrature: str
    feature: str
    share: float
    z: float
    left_out: float


def gap_map(model: CampaignModel, solution: Solution) -> tuple[Cell, ...]:
    """Cells from the largest share down."""
    cells: list[tuple[float, Cell]] = []
    leverage = solution.basis
    first = 0
    for r in model.evidence:
        size = 2 * r.signal.lhs.size
        rows = slice(first, first + size)
        first += size
        predicted = _left_out(solution.residual[rows], leverage[rows])
        cells += _cells(r, solution.residual[rows], predicted)
    total = sum(square for square, _ in cells) or 1.0
    ordered = sorted(cells, key=lambda pair: -pair[0])
    return tuple(Cell(c.experiment, c.channel, c.quadrature, c.feature, square / total, c.z, c.left_out) for square, c in ordered)


def _left_out(residual: FloatArray, basis: FloatArray) -> FloatArray:
    """Residual of an experiment against the fit to all others: (1 - H)^-1 e, in units of its own prediction's noise."""
    spare = np.eye(residual.size) - basis @ basis.T
    values, vectors = np.linalg.eigh(spare)
    kept = values > 0.05
    root = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(root @ (vectors[:, kept].T @ residual))


def _cells(r: RecordingEvidence, residual: FloatArray, predicted: FloatArray) -> list[tuple[float, Cell]]:
    half = r.signal.lhs.size // 2
    lines = r.signal.frequency_hz[:half]
    out = []
    for side in range(2):
        for part in range(2):
            rows = slice((2 * part + side) * half, (2 * part + side + 1) * half)
            own, other = residual[rows], predicted[rows]
            for f in np.unique(lines):
                at = lines == f
                z, left_out = float(np.linalg.norm(own[at])), float(np.linalg.norm(other[at]))
                channel, quadrature = _words(r, side, part)
                excess = max(left_out**2 - int(at.sum()), 0.0)
                out.append((excess, Cell(r.recording.label, channel, quadrature, _feature(r, float(f)), 0.0, z, left_out)))
    return out


def _words(r: RecordingEvidence, side: int, part: int) -> tuple[str, str]:
    quadrature = ("in phase with velocity", "in phase with displacement")[part]
    if not r.is_wave:
        return f"{'xy'[side]} pick-off", quadrature
    return ("amplitude", "frequency", "precession", "quadrature")[2 * side + part], quadrature


def _feature(r: RecordingEvidence, f: float) -> str:
    if f == 0.0:
        return "mean"
    nu = r.recording.command.excitation.frequency_hz
    if r.recording.command.excitation.kind.endswith("modulation") and nu > 0.0:
        return f"side band {round(f / nu)} x {nu:g} Hz"
    turn = r.signal.turn_rad / (2.0 * np.pi * r.recording.duration_s)
    if turn * r.recording.duration_s > 0.9:
        return f"{2.0 * f / turn:.1f} theta"
    return f"{f:.3g} Hz"
