"""Images of converters that stand still: a resonance at a multiple of half the loops' rate meets its own mirror.

A voltage that is renewed every T holds, besides u(t), images at all multiples of 1/T; so does a reading that is averaged over T. Of a
carrier f the image of the conjugate lies at n/T - f, and is `u'* T / (2 pi n i)` in size for what changes slowly. Where 2 f is n/T within
what a record resolves it does not turn any more against the carrier, and a side band is answered by its own mirror: of a ring of
14999.986 Hz whose loops run at 10 kHz an amplitude modulation of 1.5 Hz left 62 in chi-square in one record (202 in all, without noise;
5 where the resonance lies 0.06 Hz higher). So is the drive that makes a wave precess, which turns with it: of a hemisphere of 5000.303 Hz
one of 1.7 V at 0.8 rad/s left 50 in the line of one record nearest 0.606 Hz. With n/T = 2 f the size is `u'* / (4 pi f)`, whatever the
rate; only the phase, which depends on where a record began, is free.

Where drives and readings take turns, each in a slot of its own, the image goes with the voltage itself, by how far it is from standing
still: `(2 omega - 2 pi n/T) u* / (4 pi f)`, which is 1.02 to 1.04 of what multiplexed electronics show, and none of the other (0.04). Of
a healthy hemisphere whose image turned at 0.2 Hz once it was hot, a wave that precessed left 680 in chi-square of 44 lines without it,
140 with it.

A stiffness that is renewed in steps while the temperature moves (a plant's, a tuning voltage's) works on where the carrier happens to be:
of ``a'/a = (omega'/2 omega)(cos 2 phi - 1)`` the cosine does not average out where 2 f passes a multiple of the rate of steps. Of the
practice hemisphere, which passes 10 kHz at 0.7 Hz/s, a warmed record held 83 times the noise at rest, and nine tenths of it were that: 1.05
of the formula by its rows (`stiffness_image.py`), 2.3 by its few lines.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .columns import part_columns
from .evidence import CampaignEvidence, RecordingEvidence
from .parts import Kind, Linear, Part
from .signals import Signals
from .spectra import RATES_HZ

__all__ = ["image_columns", "stiffness_image"]

ComplexArray = NDArray[np.complex128]
#: how near twice the carrier must be to a multiple of the converters' rates for the image of an excitation to stand still [Hz]
_NEAR_HZ = 0.3
#: angle that a wave must turn by for its drives to turn [rad]; how wide a line is, in lines of its record
_TURNING_RAD, _LINES = 0.3, 2.0
#: size of the image of a stiffness over that of steps, sd
_STEPPED = 2.0


def image_columns(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Images of drives and of a stiffness that is warmed in every record in which they can be seen, two phases, as the formulas have it.

    That of the reading is the same force to within what the flow tells, and shares the columns.
    """
    return [*_of_drives(evidence, linear), *_of_stiffness(evidence, linear)]


def _of_drives(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Of the drives that turn or are excited."""
    heard = [(r, near_hz) for r in evidence if r.is_wave and (near_hz := _reach_hz(r)) > 0.0]
    images, slots = {}, {}
    for r, near_hz in heard:
        if (mirror := _mirror(r.signals, near_hz)) is None:
            continue
        images[r.index] = mirror * np.gradient(r.signals.drive, r.signals.row_s, axis=0).conj()
        if r.signal.turn_rad >= _TURNING_RAD:
            slots[r.index] = np.gradient(mirror, r.signals.row_s, axis=0) * r.signals.drive.conj()
    held = _in_two_phases(evidence, linear, images, "image", "drive", 1.0)
    return [*held, *_in_two_phases(evidence, linear, slots, "slot_image", "drive", 1.0)]


def _of_stiffness(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Of a stiffness that follows the temperature in steps: what is left of it where rows have told it (`stiffness_image.py`)."""
    images = {r.index: image for r in evidence if (image := stiffness_image(r)) is not None}
    columns = _in_two_phases(evidence, linear, images, "stiffness_image", "flow", _STEPPED)
    sds = [sd for index in images for sd in [evidence.image_sd.get(index, _STEPPED)] * 2]
    return [replace(c, prior_sd=sd) for c, sd in zip(columns, sds, strict=True)]


def stiffness_image(r: RecordingEvidence) -> ComplexArray | None:
    """The image of a stiffness that is warmed in steps [V/s], shape (n, 2); None where it never stands still.

    Parameters
    ----------
    r : RecordingEvidence
    """
    if not (r.is_wave and r.is_warming):
        return None
    mirror = _mirror(r.signals, float(r.lines("amplitude").frequency_hz.max()))
    if mirror is None:
        return None
    # the mirror is 1/(2 pi n/T) in size, and n/T is 2 f
    return np.asarray(np.gradient(r.signals.omega_rad_s, r.signals.row_s)[:, None] * mirror * r.signals.pick.conj())


def _in_two_phases(
    evidence: CampaignEvidence, linear: Linear, images: dict[int, ComplexArray], name: str, kind: Kind, prior_sd: float
) -> list[Column]:
    """Columns of images, given by the index of their record."""
    if not images:
        return []
    by_recording = []
    for r in evidence:
        parts = []
        for index, own in images.items():
            image = own if index == r.index else np.zeros_like(own, shape=r.signals.drive.shape)
            parts += [Part(f"{name}_{index}_re", kind, image), Part(f"{name}_{index}_im", kind, 1j * image)]
        by_recording.append(parts)
    return [replace(c, prior_sd=prior_sd) for c in part_columns(evidence, by_recording, linear)]


def _reach_hz(r: RecordingEvidence) -> float:
    """How fast an image may turn against the carrier and still be in a line of the record; zero if its drives have none."""
    if r.recording.command.excitation.kind != "none":
        return _NEAR_HZ
    if r.signal.turn_rad < _TURNING_RAD:
        return 0.0
    # a conjugate turns against the wave as often as its drives with it
    turns_hz = r.signal.turn_rad / r.recording.duration_s / np.pi
    return float(r.lines("amplitude").frequency_hz.max() + turns_hz + _LINES / r.recording.duration_s)


def _mirror(s: Signals, near_hz: float = _NEAR_HZ) -> ComplexArray | None:
    """Turns a conjugate into its image [s], shape (n, 1); nothing where the image is never nearer than that to standing still."""
    twice_hz = s.omega_rad_s / np.pi
    # a resonance that is warmed may pass several multiples: one image at a time is near enough to be heard
    multiples = RATES_HZ * np.arange(np.floor(twice_hz.min() / RATES_HZ), np.ceil(twice_hz.max() / RATES_HZ) + 1.0)
    nearest = np.array([np.min(np.abs(twice_hz - still_hz)) for still_hz in multiples])
    if nearest.min() > near_hz:
        return None
    still_hz = float(multiples[np.argmin(nearest)])
    turned = 2.0 * np.pi * np.cumsum(twice_hz - still_hz) * s.row_s
    return np.asarray(np.exp(-1j * turned)[:, None] / (2.0 * np.pi * still_hz))
