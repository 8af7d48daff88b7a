"""A campaign as linear equations: every recording projected on test functions, in the frame of its wave.

The slow flow stays exact and linear in (A, G~, E) (:mod:`..estimation.projection`), whatever controlled the device: loops, latencies and
set points drop out, because what acted stands in the drive columns. So the same equations serve force-rebalance and whole-angle records of
any maker's device, and what they leave over is the gap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..estimation.wave import wave_coordinates
from ..estimation.wave_lines import role_of
from ..estimation.wave_projection import Products, WaveProjected, in_wave_frame, thinning
from ..recording.recording import Recording
from .healthy import HealthySpread
from .lines import lines_of
from .noise_law import IN_PHASE, Grams, Lines
from .signals import WARMING_K, Projector, Signals, smooth_temperature

__all__ = ["CHANNELS", "STEADY", "WARMING", "CampaignEvidence", "RecordingEvidence"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: of a wave: along it (real: amplitude, imaginary: frequency), then across it
CHANNELS = ("amplitude", "frequency", "precession", "quadrature")
#: effective frequency of a record's mean over one by its duration; of the mean of a wave's frequency, which walks by a nuisance of its own
MEAN_LINE, OWN_MEAN_LINE = 0.3, 10.0
#: over which the pace of a temperature is read [s]; what it may jump between two recordings [K], and how much faster it may go there than
#: it ever went in one: a clock that stood while a chamber went back tells no memory of the recording before
_SLOPE_S, _STEP_K, _TIMES_FASTER = 1.0, 0.5, 2.0
#: most of half a turn of psi, the period of 4 theta: an eleventh plant's records held 0.98 of it
_TURNED_RAD = 0.75 * math.pi
#: keys of the noise of a wave's frequency, of which a temperature moves and of which none does
STEADY, WARMING = ("wave", "frequency"), ("wave, warming", "frequency")


@dataclass(frozen=True)
class RecordingEvidence:
    """The equations of one recording.

    Parameters
    ----------
    index : int
        Place in the campaign.
    recording : Recording
    signals : Signals
    signal, quiet : WaveProjected
        Base equations on the lines of interest, and where only noise is expected.
    signal_forms, quiet_forms : Projector
        Project the forms of effects on the same lines.
    turn : complex
        Unit number that turns the equations by the phase of the wave against the reference.
    campaign_s : float
        How long the campaign lasted [s].
    """

    index: int
    recording: Recording
    signals: Signals
    signal: WaveProjected
    quiet: WaveProjected
    signal_forms: Projector
    quiet_forms: Projector
    turn: complex
    campaign_s: float = 0.0

    @property
    def role(self) -> str:
        """Recordings of one role share their noise."""
        role = role_of(self.recording)
        return f"{role}, warming" if self.is_warming else role

    def noise_key(self, channel: str) -> tuple[str, str]:
        """What shares its noise with this recording's channel: the frequency of a wave wanders alike in every mode, relative to it."""
        if channel == "frequency" and self.is_wave:
            return WARMING if self.is_warming else STEADY
        return (self.role, channel)

    def lines(self, channel: str, *, quiet: bool = False) -> Lines:
        """Test functions of a channel; the frequency of a wave is relative to its amplitude."""
        if (channel, quiet) not in self._lines:
            self._lines[channel, quiet] = self._made_lines(channel, quiet=quiet)
        return self._lines[channel, quiet]

    @cached_property
    def _lines(self) -> dict[tuple[str, bool], Lines]:
        return {}

    def _made_lines(self, channel: str, *, quiet: bool) -> Lines:
        projector = self.quiet_forms if quiet else self.signal_forms
        f = projector.frequency_hz
        slope = projector.signals.row_s * np.sum(projector.first**2, axis=1) / (2.0 * np.pi) ** 2
        floors = self._floors(channel, quiet=quiet)
        if channel != "frequency" or not self.is_wave:
            mean = np.where(f == 0.0, MEAN_LINE / self.recording.duration_s, f)
            return Lines(mean, slope, 1.0, f == 0.0, floors=floors)
        # the mean frequency of a record is a nuisance of its own, whose size is measured: its line holds little noise beside that
        mean = np.where(f == 0.0, OWN_MEAN_LINE / self.recording.duration_s, f)
        return Lines(mean, slope, self.mean_square, f == 0.0, np.diag(projector.walk_gram), floors=floors)

    def _floors(self, channel: str, *, quiet: bool) -> FloatArray:
        """What floors of the pick-offs bring to a channel.

        In phase a wave hears gains, else phases, alike. An open drive's wave has any phase, and what stands still while it is recorded is
        an error of its size all the same: every channel hears both.
        """
        in_phase, other = self._quiet_floors if quiet else self._signal_floors
        count = in_phase.shape[1] // 2
        side = slice(0, count) if channel in CHANNELS[:2] else slice(count, None)
        if self.is_wave:
            return in_phase[:, side, side]
        both = (in_phase, other) if channel in IN_PHASE else (other, in_phase)
        return np.concatenate([part[:, side, side] for part in both])

    @cached_property
    def _signal_floors(self) -> tuple[FloatArray, FloatArray]:
        return self._floors_of(self.signal_forms)

    @cached_property
    def _quiet_floors(self) -> tuple[FloatArray, FloatArray]:
        return self._floors_of(self.quiet_forms)

    def _floors_of(self, projector: Projector) -> tuple[FloatArray, FloatArray]:
        """Of gains in the real parts and in the imaginary ones, where only an open drive's are heard; of phases the other way round."""
        if self.is_wave:
            both = projector.gain_floors(self.turn)
            return both, both
        return projector.gain_floors(self.turn, self.campaign_s), projector.gain_floors(-1j * self.turn, self.campaign_s)

    @cached_property
    def grams(self) -> Grams:
        """Of the test functions of one side at the signal's lines."""
        count = self.signal.gram.shape[0] // 2
        return Grams(self.signal.gram[:count, :count], self.signal_forms.walk_gram)

    @cached_property
    def mean_square(self) -> float:
        """Mean squared amplitude [V^2]."""
        return float(np.mean(np.sum(np.abs(self.signals.pick) ** 2, axis=1)))

    @property
    def parent_role(self) -> str:
        """Role of the plain records of this one's mode."""
        mode = self.recording.command.mode
        if mode == "loops_off":
            return self.role
        return mode if self.recording.command.oscillator_axis else "precession"

    @property
    def condition(self) -> tuple[object, ...]:
        """Records of one condition repeat one another at their mean: the side band of an excitation does not reach it."""
        setpoints = self.recording.command.setpoints
        azimuth = round(float(np.angle(complex(*np.abs(self.signals.pick[:50]).mean(axis=0)))), 1)
        volts = round(setpoints.virtual_precession_v, 6)
        return (self.role, round(setpoints.amplitude_v, 6), volts, azimuth, setpoints.rebalance, round(self.recording.duration_s, 1))

    @property
    def is_warming(self) -> bool:
        """Whether the temperature moved: its sensor's noise and lag are then in the frequency."""
        return bool(np.ptp(self.signals.temperature_k) > WARMING_K)

    @property
    def is_turning(self) -> bool:
        """Whether the wave turned through most of the directions that it can lie along, as in one period of 4 theta."""
        return self.signal.turn_rad > _TURNED_RAD

    @property
    def is_wave(self) -> bool:
        """Whether there is a wave (loops closed); otherwise the frame is that of the axes."""
        return in_wave_frame(self.recording)


@dataclass(frozen=True)
class CampaignEvidence:
    """All recordings.

    Parameters
    ----------
    recordings : tuple of RecordingEvidence
    omega0_rad_s : float
        Frequency about which A and G are written.
    decay_rate : float
        Rough 1/tau [1/s].
    temperature_degc : float
        What temperatures are counted from.
    phase_floors : tuple of float
        Of the x and y pick-offs' phases [rad^2/Hz], where they are more than a healthy device's.
    healthy : HealthySpread
        How large what no one calls a gap is on a device of this kind.
    image_sd : mapping of int to float
        How well the images of a stiffness were told that were taken off, over the formula's size, by index of the recording.
    """

    recordings: tuple[RecordingEvidence, ...]
    omega0_rad_s: float
    decay_rate: float
    temperature_degc: float
    phase_floors: tuple[float, float] = (0.0, 0.0)
    healthy: HealthySpread = field(default_factory=HealthySpread)
    image_sd: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def of(cls, recordings: Sequence[Recording], decay_rate: float, healthy: HealthySpread | None = None) -> CampaignEvidence:
        """Project recordings; ``healthy``: as of any device where it is not given."""
        closed = [r for r in recordings if in_wave_frame(r)]
        temperature = float(np.median([np.median(r.temperature_degc) for r in recordings]))
        omega0 = float(np.median([np.median(r.ref_omega_rad_s) for r in closed]))
        start, end = min(float(r.t[0]) for r in recordings), max(float(r.t[-1]) for r in recordings)
        found: dict[int, RecordingEvidence] = {}
        fastest = max(_fastest(r) for r in recordings)
        before: Signals | None = None
        for i in np.argsort([float(r.t[0]) for r in recordings], kind="stable"):
            if before is not None and not _follows(before.recording, recordings[i], fastest):
                before = None
            found[int(i)] = _evidence(int(i), recordings[i], omega0, decay_rate, temperature, (start, end), before)
            before = found[int(i)].signals
        projected = tuple(found[i] for i in range(len(recordings)))
        return cls(projected, omega0, decay_rate, temperature, healthy=healthy or HealthySpread())

    def replaced(self, recordings: Mapping[int, Recording]) -> CampaignEvidence:
        """With some recordings, by index, projected again from what stands in their place."""
        found = list(self.recordings)
        for i, recording in recordings.items():
            s = found[i].signals
            lasted = s.start_s, s.start_s + found[i].campaign_s
            found[i] = _evidence(i, recording, self.omega0_rad_s, self.decay_rate, self.temperature_degc, lasted, s.before)
        return replace(self, recordings=tuple(found))

    def __iter__(self):  # type: ignore[no-untyped-def]
        return iter(self.recordings)

    def __len__(self) -> int:
        return len(self.recordings)

    @property
    def turns(self) -> bool:
        """Whether the wave of any recording turned."""
        return any(r.is_turning for r in self.recordings)


def _fastest(r: Recording) -> float:
    """How fast the temperature of a recording went at most [K/s], over a second."""
    rows = max(1, round(_SLOPE_S * r.sample_rate_hz))
    kelvins = smooth_temperature(r)
    return float(np.abs(kelvins[rows:] - kelvins[:-rows]).max(initial=0.0)) / _SLOPE_S


def _follows(before: Recording, after: Recording, fastest_k_s: float) -> bool:
    """Whether the clock ran on between two recordings; not where the device was brought to another temperature faster than it can be."""
    jump = abs(float(smooth_temperature(after)[0] - smooth_temperature(before)[-1]))
    return jump < _STEP_K + _TIMES_FASTER * fastest_k_s * max(float(after.t[0] - before.t[-1]), 0.0)


def _evidence(
    index: int,
    recording: Recording,
    omega0: float,
    decay_rate: float,
    temperature: float,
    lasted: tuple[float, float],
    before: Signals | None,
) -> RecordingEvidence:
    start, end = lasted
    signals = Signals(recording, omega0, decay_rate, thinning(recording), temperature, start, index, before)
    rise = smooth_temperature(recording) - temperature
    products = Products(
        recording,
        omega0,
        decay_rate,
        plain={
            "warm": lambda V, u, rate: (rise[:, None] * V)[:, None, :],
            "warm2": lambda V, u, rate: ((rise**2)[:, None] * V)[:, None, :],
        },
        derived={},
        in_phase=signals.is_warming,
    )
    lines = lines_of(recording, products.speed_rad_s)
    phase = 1.0 + 0j
    if in_wave_frame(recording):
        wave = wave_coordinates(recording)
        weight = wave.amplitude_v**2
        mean = complex(np.sum(weight * np.exp(1j * wave.phase_rad)))
        phase = mean.conjugate() / abs(mean) if abs(mean) > 0.1 * math.fsum(weight) else 1.0 + 0j
    return RecordingEvidence(
        index, recording, signals,
        products.project(lines.signal), products.project(lines.quiet),
        signals.projector(lines.signal), signals.projector(lines.quiet), phase, end - start,
    )  # fmt: skip
