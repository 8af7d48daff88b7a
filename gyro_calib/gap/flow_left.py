"""What the linear device leaves of the slow flow, row by row and relative to the wave: where effects show that keep to no line.

With the motion ``m = V - E u`` every row leaves ``m' + i (omega - omega0) m - A m - G u``, in the frame of the wave and over its amplitude:
along it how fast the amplitude and the phase go otherwise than they should, across it precession and quadrature. What the loops do about
it stands in the drives, so an unmodelled change shows as what it is and not as what the loops make of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .evidence import CHANNELS, CampaignEvidence, RecordingEvidence
from .linear_device import TEMPERATURE_SPAN_K
from .parts import Linear, motion, unexplained
from .signals import Signals
from .spectra import is_plain

__all__ = ["FlowLeft", "flows_left", "rows_left"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: turns of psi in a recording below which its wave stands still
_STILL_TURNS = 0.01


@dataclass(frozen=True)
class FlowLeft:
    """Of one recording.

    Parameters
    ----------
    label : str
    kind : tuple
        Recordings of one kind share their noise.
    row_s : float
        Time of a row [s].
    carrier_hz : float
        Mean frequency of the reference.
    excited_hz : float
        Side band, 0 without.
    turning_hz : float
        Turns of psi a second.
    rate : mapping of str to ndarray, shape (n,)
        Relative rate of change that nothing explains [1/s], by channel, less its mean and slope.
    azimuth_rad : ndarray, shape (n,)
        Of the wave.
    start_s : float
        Device time of its first row.
    """

    label: str
    kind: tuple[object, ...]
    row_s: float
    carrier_hz: float
    excited_hz: float
    turning_hz: float
    rate: dict[str, FloatArray]
    azimuth_rad: FloatArray
    start_s: float = 0.0

    @property
    def is_still(self) -> bool:
        """Whether no side band and no turn of the wave moves anything."""
        return self.excited_hz == 0.0 and self.stands

    @property
    def stands(self) -> bool:
        """Whether its wave keeps its azimuth."""
        return self.turning_hz * self.duration_s < _STILL_TURNS

    @property
    def amplitude_v(self) -> float:
        """Set point, by which the flow is relative."""
        return float(self.kind[1])  # type: ignore[arg-type]

    @property
    def duration_s(self) -> float:
        """Rows times their time."""
        return self.row_s * len(self.rate[CHANNELS[0]])


def flows_left(evidence: CampaignEvidence, linear: Linear) -> list[FlowLeft]:
    """Of every plain recording: a held wave that nothing but a side band or its own precession moves."""
    return [_flow_left(r, linear) for r in _plain(evidence)]


def rows_left(s: Signals, linear: Linear) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Azimuth of the wave [rad], and what the linear device leaves along it and across it over its amplitude [1/s], shape (n,) each.

    A difference of rows to both sides is the mean of what moves the wave in between, which bends where a drive runs against its limit: of a
    healthy hemisphere five such corners in rows of 10 ms were kicks of 11 usual sizes.
    """
    m = motion(s, linear)
    slope = np.gradient(m, s.row_s, axis=0)
    left = slope + _between(unexplained(s, linear) - slope)
    phase = np.exp(-0.5j * np.unwrap(np.angle(np.sum(m**2, axis=1))))
    turned, left = m * phase[:, None], left * phase[:, None]
    azimuth = np.unwrap(np.arctan2(turned[:, 1].real, turned[:, 0].real))
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    size = np.hypot(turned[:, 0].real, turned[:, 1].real)
    return azimuth, (cos * left[:, 0] + sin * left[:, 1]) / size, (cos * left[:, 1] - sin * left[:, 0]) / size


def _between(x: ComplexArray) -> ComplexArray:
    """Mean of a signal from the row before each to the row after it, by Simpson's rule, shape (n, 2)."""
    mean = x.copy()
    mean[1:-1] = (x[:-2] + 4.0 * x[1:-1] + x[2:]) / 6.0
    return mean


def _plain(evidence: CampaignEvidence) -> Iterable[RecordingEvidence]:
    """At the temperature at which the linear device was found: at another, gains are others, and a turning wave shows it."""
    near = (r for r in evidence if abs(float(r.signals.temperature_k.mean())) < TEMPERATURE_SPAN_K)
    return (r for r in near if is_plain(r.recording))


def _flow_left(r: RecordingEvidence, linear: Linear) -> FlowLeft:
    s, command = r.signals, r.recording.command
    azimuth, along, across = rows_left(s, linear)
    return FlowLeft(
        r.recording.label,
        (command.mode, round(command.setpoints.amplitude_v, 6), command.setpoints.virtual_precession_v != 0.0),
        s.row_s,
        float(r.recording.ref_omega_rad_s.mean()) / (2.0 * np.pi),
        command.excitation.frequency_hz if command.excitation.kind != "none" else 0.0,
        abs(float(azimuth[-1] - azimuth[0])) / (2.0 * np.pi * s.row_s * len(azimuth)),
        {name: _straightened(x) for name, x in zip(CHANNELS, (along.real, along.imag, across.real, across.imag), strict=True)},
        azimuth,
        s.start_s + float(s.time_s[0]),
    )


def _straightened(x: FloatArray) -> FloatArray:
    place = np.linspace(-1.0, 1.0, len(x))
    return np.asarray(x - x.mean() - place * float(place @ x) / float(place @ place))
