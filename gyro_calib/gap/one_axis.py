"""A campaign in which the wave, and the open drive, never leave one axis: of the other's gain and damping it tells next to nothing.

There the pick-off holds noise and the drive answers it, as its controller has it, so that ``V' = -k V`` to the last digit. With damping and
gain of that axis free, A = -k and G = 0 explain the noise itself: the practice ring's x alone left a ten-thousandth of it, and whatever
was not in that law, a side band, a table's step, was something unknown. But both axes are of one design. So what is sought is by how much
the other's damping and gain differ from those of the axis that was told, and of effects nothing that grows from the other's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .column import Column
from .evidence import CampaignEvidence

__all__ = ["axis_alone", "heard", "holding_gain", "of_both", "untied"]

ComplexArray = NDArray[np.complex128]
#: how far damping and gain of one axis may be from the other's, sd over them, and how far its resonance, over its frequency
_DAMPING, _GAIN, _SPLIT = 0.3, 0.03, 1e-3
#: size of an effect's column over that of its fellow on the axis that oscillates, below which it holds but noise
_NOISE = 0.03
#: what both axes have alike, by matrix and part
_ALIKE = (("A", "re"), ("G", "re"), ("G", "im"))


def axis_alone(evidence: CampaignEvidence) -> int | None:
    """The axis (0 or 1) of every wave and of every open drive, if there is but one."""
    if evidence.turns:
        return None
    commands = [r.recording.command for r in evidence]
    axes = {c.oscillator_axis for c, r in zip(commands, evidence, strict=True) if r.is_wave}
    axes |= {c.excitation.axis for c in commands if c.excitation.kind == "drive"}
    return "xy".index(axes.pop()) if axes in ({"x"}, {"y"}) else None


def of_both(evidence: CampaignEvidence, columns: Sequence[Column]) -> list[Column]:
    """Columns of the linear device with what differs in place of the other axis' damping and gain; as they are where both axes are told.

    Parameters
    ----------
    evidence : CampaignEvidence
    columns : sequence of Column
        ``A_xx_re`` to ``G_yy_im`` among them.
    """
    axis = axis_alone(evidence)
    if axis is None:
        return list(columns)
    own, other = "xy"[axis] * 2, "yx"[axis] * 2
    gain = holding_gain([r.recording for r in evidence], evidence.decay_rate)
    known = {
        f"A_{other}_re": _DAMPING * evidence.decay_rate,
        f"A_{other}_im": _SPLIT * evidence.omega0_rad_s,
        f"G_{other}_re": _GAIN * gain,
        f"G_{other}_im": _GAIN * gain,
    }
    by_name = {c.name: c for c in columns}
    alike = {f"{letter}_{own}_{part}": f"{letter}_{other}_{part}" for letter, part in _ALIKE}
    return [
        _summed(c, by_name[alike[c.name]]) if alike.get(c.name) in by_name else replace(c, prior_sd=known.get(c.name, c.prior_sd))
        for c in columns
    ]


def heard(evidence: CampaignEvidence, columns: Sequence[Column]) -> list[Column]:
    """An effect's columns without those of an axis that holds but noise, which in a closed loop they would explain.

    Parameters
    ----------
    evidence : CampaignEvidence
    columns : sequence of Column
        Of one effect; those of one parameter of each axis differ in a letter, those of an unnamed term in a number.
    """
    if axis_alone(evidence) is None:
        return list(columns)
    size = {c.name: float(np.sqrt(sum(np.sum(np.abs(v) ** 2) for v in c.signal))) for c in columns}
    largest: dict[str, float] = {}
    for name, norm in size.items():
        largest[_stem(name)] = max(norm, largest.get(_stem(name), 0.0))
    return [c for c in columns if size[c.name] >= _NOISE * largest[_stem(c.name)]]


def _stem(name: str) -> str:
    """Name of a parameter without its axis."""
    return name[:-1] if name[-1] in "xy0123456789" else name


def holding_gain(recordings: Sequence[Recording], decay_rate: float) -> float:
    """Gain of drives that hold waves against their damping [1/s], whichever columns are whose.

    Parameters
    ----------
    recordings : sequence of Recording
    decay_rate : float
        Rough 1/tau [1/s].
    """
    waves = [r for r in recordings if r.command.mode != "loops_off"]
    return decay_rate * float(np.median([np.linalg.norm(r.pick) / max(float(np.linalg.norm(r.drive)), 1e-300) for r in waves]))


def untied(evidence: CampaignEvidence, A: ComplexArray, G: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """A and G, shape (2, 2), of values of the columns of :func:`of_both`."""
    axis = axis_alone(evidence)
    if axis is None:
        return A, G
    A, G, other = A.copy(), G.copy(), 1 - axis
    A[other, other] += A[axis, axis].real
    G[other, other] += G[axis, axis]
    return A, G


def _summed(one: Column, other: Column) -> Column:
    sides = ((one.signal, other.signal), (one.quiet, other.quiet))
    signal, quiet = (tuple(a + b for a, b in zip(*side, strict=True)) for side in sides)
    return replace(one, signal=signal, quiet=quiet)
