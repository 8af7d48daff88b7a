"""The image of a stiffness that is warmed in steps, measured where it goes fastest.

A wave that warms through a multiple of half the rate of steps shows it as a chirp (:mod:`.images`): cycles a second, slower and slower,
then faster again. Only the moment between falls on the few lines of its record, where all that follows the temperature may take it, and
the rest on the quiet ones, which are to say what noise there is: the amplitude of a healthy hemisphere of plant 33 held 1991 times the
noise at rest, 70 without the chirp. But its rows tell it: above a hertz the amplitude has nothing else that turns so. Of five hemispheres
of three plants it is 0.98 to 1.06 of what the formula says, each +- 0.08; it is taken off, and what is left of it has that sd.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from .columns import part_columns
from .evidence import CampaignEvidence, RecordingEvidence
from .flow_left import rows_left
from .images import stiffness_image
from .parts import Linear, Part, motion

__all__ = ["less_stiffness_images"]

ComplexArray = NDArray[np.complex128]
#: what is slower than this other things do as well, and what is faster the rows' filter may take [Hz]
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 8.0
#: an image is told that is so many of its sd, of so many figures at least
_TOLD, _FEWEST = 6.0, 40


def less_stiffness_images(evidence: CampaignEvidence, linear: Linear) -> CampaignEvidence:
    """The equations less the images that rows tell, and how well they do.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
        Of the linear device: what it leaves of the amplitude is looked at.
    """
    images = {r.index: image for r in evidence if (image := stiffness_image(r)) is not None}
    told = {index: size for index, image in images.items() if (size := _measured(evidence.recordings[index], linear, image)) is not None}
    if not told:
        return evidence
    parts = []
    for r in evidence:
        image = told[r.index][0] * images[r.index] if r.index in told else np.zeros_like(r.signals.pick)
        parts.append([Part("image", "flow", np.asarray(image))])
    (column,) = part_columns(evidence, parts, linear)
    recordings = tuple(
        replace(r, signal=replace(r.signal, lhs=r.signal.lhs - s / r.turn), quiet=replace(r.quiet, lhs=r.quiet.lhs - q / r.turn))
        for r, s, q in zip(evidence, column.signal, column.quiet, strict=True)
    )
    return replace(evidence, recordings=recordings, image_sd={index: sd for index, (_, sd) in told.items()})


def _measured(r: RecordingEvidence, linear: Linear, image: ComplexArray) -> tuple[complex, float] | None:
    """Size of an image over the formula's, of any phase, and its sd; None where rows do not tell it."""
    s = r.signals
    azimuth, along, _ = rows_left(s, linear)
    # of the motion, as the azimuth is: another branch of its phase would turn the image's sign
    m = motion(s, linear)
    phase = np.exp(-0.5j * np.unwrap(np.angle(np.sum(m**2, axis=1))))
    wave = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1) / np.linalg.norm(m, axis=1)[:, None]
    seen = np.sum(wave * image * phase[:, None], axis=1)
    frequency_hz = np.arange(len(along)) / (2.0 * len(along) * s.row_s)
    told = (frequency_hz > _SLOWEST_HZ) & (frequency_hz < min(_FASTEST_HZ, 0.25 / s.row_s))
    if np.count_nonzero(told) < _FEWEST:
        return None
    columns = np.stack([dct(seen.real, norm="ortho")[told], dct(-seen.imag, norm="ortho")[told]], axis=1)
    amplitude = dct(along.real, norm="ortho")[told]
    (re, im), *_ = np.linalg.lstsq(columns, amplitude, rcond=None)
    left = amplitude - columns @ (re, im)
    precision = columns.T @ columns
    sd = float(np.sqrt(np.trace(np.linalg.inv(precision)) / 2.0 * left.var())) if np.linalg.cond(precision) < 1e6 else np.inf
    return (complex(re, im), sd) if abs(complex(re, im)) > _TOLD * sd else None
