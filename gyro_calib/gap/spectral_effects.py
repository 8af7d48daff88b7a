"""Effects that stand in the spectrum and not in the slow flow, as findings beside those of the fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..effects import EFFECTS
from ..quantity import Quantity
from ..recording.recording import Recording
from .converter_steps import ConverterSteps, converter_steps
from .diagnosis import FoundEffect, Standing, Unknown
from .noise_growth import NoiseGrowth, noise_growth
from .open_lines import OpenLine
from .parts import Linear
from .reference_spur import is_driven, phase_swing, steered_swing
from .spectra import near_line, pick_spectra, plain_records
from .swings import Swing
from .tones import Tone, find_tone

__all__ = ["SAMPLED", "SEEN", "SIGMA", "SPECTRAL", "SpectralEffects", "found_beside", "spectral_effects"]

#: effects that are found here: in the spectra, and in samples at the converters' rate
SPECTRAL = ("external_tone", "mains_pickup", "amplitude_noise", "reference_spur", "base_sway")
SAMPLED = ("pickoff_quantisation",)

#: significance from which on what no fit tells is a finding, in standard deviations; what would have been seen nine times in ten
SIGMA = 6.0
SEEN = SIGMA + 1.28
#: how much of a line's own gain, times its squared share of the wave, its squares may have where the model looks
_SQUARES = 3.0
#: probability of a finding that is as strong as it must be here
_PROBABILITY = 0.95
#: steps of the drives' converter stand in no spectrum: their samples and the slow flow tell them (`coarse_drive.py`), or nothing does
_NOT_TESTABLE = ("drive_quantisation",)


@dataclass(frozen=True)
class SpectralEffects:
    """What the spectra say.

    Parameters
    ----------
    effects : tuple of FoundEffect
    unknown : Unknown or None
        A gain, or drives, that go to and fro; noise across the phase that grows with the amplitude, a clock's.
    standings : tuple of Standing
        One line per effect of this kind.
    products : float
        Gain that the squares of a line may have in the slow flow: what is found there and no larger may be no more than that.
    near : tuple of int
        Recordings, by their place, whose reference stands so near to a tone that it belongs to their signal, or on whose lines it leaks.
    """

    effects: tuple[FoundEffect, ...]
    unknown: Unknown | None
    standings: tuple[Standing, ...]
    products: float = 0.0
    near: tuple[int, ...] = ()


def spectral_effects(
    recordings: Sequence[Recording],
    linear: Linear,
    without: Iterable[str] = (),
    swings: Sequence[Swing] = (),
    near_tone: Tone | None = None,
    open_line: OpenLine | None = None,
) -> SpectralEffects:
    """Lines that no command asks for, and a floor that grows with the amplitude.

    Parameters
    ----------
    recordings : sequence of Recording
    linear : Linear
    without : iterable of str
        Effects that the registry shall not hold (blind trials): of a line that is there all the same nothing is said.
    swings : sequence of Swing
        What goes to and fro in the slow flow.
    near_tone : Tone or None
        Within the signal, where the spectra hear nothing.
    open_line : OpenLine or None
        Beside open drives, where held waves show nothing.
    """
    left_out = set(without)
    spectra = pick_spectra(recordings)
    tone, growth = _not_swinging(find_tone(spectra, linear), swings, recordings), noise_growth(recordings)
    if near_tone is not None and (tone is None or tone.log_evidence < near_tone.log_evidence):
        # what it makes in the frame of a wave goes to and fro
        tone, swings = near_tone, ()
    steps = converter_steps(recordings)
    if steps is not None and steps.undithered:
        # lines within a step, and noise that changes with the amplitude, are what such rounding makes
        tone, growth = _beyond_a_step(tone, steps, recordings), None
    effects = []
    swing = _swing(tone, recordings, linear)
    driven = _driven_line(tone, recordings, linear) if swing is None else None
    if (swing is not None or driven is not None) and any(s.is_a_rate for s in _at_line(tone, swings, recordings)):
        # a base that sways there: the loops answer it, and so their drives and their reference do
        tone = swing = driven = None
    if tone is not None and tone.name not in left_out and not tone.of_wave and swing is None and driven is None:
        effects.append(_tone(tone, left_out))
    if tone is not None and swing is not None and "reference_spur" not in left_out:
        effects.append(_spur(Quantity(tone.frequency_hz, tone.frequency_sd_hz, "Hz"), swing, tone.log_evidence))
    if tone is None and "reference_spur" not in left_out:
        effects += [_steady_spur(swing) for swing in swings if swing.swings_the_phase]
    if "base_sway" not in left_out:
        effects += [_sway(swing, linear.angular_gain) for swing in swings if swing.is_a_rate]
    # a line that grows with the wave is all of a floor that does
    rippling = driven or _rippling_gain(tone, swing)
    if any(e.name == "reference_spur" for e in effects):
        rippling, growth = None, None
    elif tone is None and not swings:
        rippling = _rippling_drive(open_line)
    if rippling is None and growth is not None and growth.gain_sigma > SIGMA and "amplitude_noise" not in left_out:
        effects.append(_noisy_gain(growth))
    rounded = steps is not None and steps.undithered and "pickoff_quantisation" not in left_out
    if steps is not None and rounded:
        effects.append(_coarse_steps(steps))
    present = {e.name for e in effects}
    alike = {name: e.name for e in effects for name in e.group[1:]}
    names = [name for name in (*SPECTRAL, *SAMPLED, *_NOT_TESTABLE) if name not in left_out]
    standings = [_standing(name, present, alike, growth, bool(spectra), _sampled(recordings)) for name in names]
    products = _SQUARES * tone.share**2 * 2.0 * tone.log_evidence if tone is not None else 0.0
    products = max(products, steps.rounded_gain if steps is not None and rounded else 0.0)
    # all recordings are near what stands within the signal, and of none it is a part that lasts
    near = () if tone is None or tone is near_tone or tone.name != "external_tone" else near_line(recordings, tone.frequency_hz)
    return SpectralEffects(tuple(effects), rippling or _noisy_clock(growth), tuple(standings), products, near)


def _tone(tone: Tone, left_out: set[str]) -> FoundEffect:
    names = ("v_x", "v_y") if tone.name == "mains_pickup" else ("a_x", "a_y")
    parameters = {"frequency_hz": Quantity(tone.frequency_hz, tone.frequency_sd_hz, "Hz")}
    parameters |= {name: Quantity(float(tone.volts[k]), float(tone.volts_sd[k]), "V") for k, name in enumerate(names)}
    alike = tuple(name for name in tone.alike if name not in left_out)
    return found_beside(tone.name, parameters, 2.0 * tone.log_evidence, alike)


def _noisy_gain(growth: NoiseGrowth) -> FoundEffect:
    unit = EFFECTS["amplitude_noise"].parameter("s").unit
    return found_beside("amplitude_noise", {"s": Quantity(*growth.gain_per_rthz, unit)}, growth.gain_sigma**2)


def _coarse_steps(steps: ConverterSteps) -> FoundEffect:
    unit = EFFECTS["pickoff_quantisation"].parameter("lsb").unit
    return found_beside("pickoff_quantisation", {"lsb": Quantity(steps.lsb_v, steps.lsb_sd_v, unit)}, SIGMA**2, harmless=False)


def found_beside(
    name: str, parameters: dict[str, Quantity], gain: float, alike: tuple[str, ...] = (), *, harmless: bool = True
) -> FoundEffect:
    """A finding that no fit made, as one of a fit."""
    effect = EFFECTS[name]
    return FoundEffect(
        name=name,
        title=effect.title,
        group=(name, *alike),
        probability=_PROBABILITY,
        parameters=parameters,
        location=effect.location,
        registry_name=name,
        gain=gain,
        harmless=harmless,
    )


def _beyond_a_step(tone: Tone | None, steps: ConverterSteps, recordings: Sequence[Recording]) -> Tone | None:
    """A line, if it is larger than half of a step."""
    amplitudes = [a for r in recordings if (a := r.command.setpoints.amplitude_v) > 0.0]
    return tone if tone is not None and amplitudes and tone.share * float(np.median(amplitudes)) > 0.5 * steps.lsb_v else None


def _sampled(recordings: Sequence[Recording]) -> bool:
    """Whether any recording holds samples of the pick-offs at the converter's rate."""
    return any(channel in (r.raw or {}) for r in recordings for channel in ("x_pick", "y_pick"))


def _swing(tone: Tone | None, recordings: Sequence[Recording], linear: Linear) -> tuple[float, float] | None:
    """Swing of the reference and its sd [rad], if the line is one: as its column says or, of one that goes with the wave, does not."""
    if tone is None or tone.name != "mains_pickup":
        return None
    steered = steered_swing(recordings, linear, tone.frequency_hz)
    return steered if steered is not None or not tone.of_wave else phase_swing(recordings, linear, tone.frequency_hz)


def _spur(frequency: Quantity, swing: tuple[float, float], log_evidence: float) -> FoundEffect:
    return found_beside("reference_spur", {"frequency_hz": frequency, "s": Quantity(*swing, "rad")}, 2.0 * log_evidence)


def _steady_spur(steady: Swing) -> FoundEffect:
    """Of a reference whose frequency column does not have all of it: loops that follow it move the wave hardly at all."""
    omega = 2.0 * math.pi * steady.frequency_hz
    frequency = Quantity(steady.frequency_hz, steady.frequency_sd_hz, "Hz")
    return _spur(frequency, (steady.size / omega, steady.size_sd / omega), steady.log_evidence)


def _sway(steady: Swing, angular_gain: float) -> FoundEffect:
    """Of a rate: a wave turns by ``-kappa`` times it (theory.md Eq. 1)."""
    parameters = {
        "frequency_hz": Quantity(steady.frequency_hz, steady.frequency_sd_hz, "Hz"),
        "r": Quantity(steady.size / angular_gain, steady.size_sd / angular_gain, "rad/s"),
        "phase_rad": Quantity(math.remainder(steady.phase_rad + math.pi, 2.0 * math.pi), steady.phase_sd_rad, "rad"),
    }
    return found_beside("base_sway", parameters, 2.0 * steady.log_evidence)


def _not_swinging(tone: Tone | None, swings: Sequence[Swing], recordings: Sequence[Recording]) -> Tone | None:
    """A line, unless it is the lesser part of what goes to and fro in the slow flow: what is added to the wave is more than that."""
    same = _at_line(tone, swings, recordings)
    return None if any(tone is not None and swing.log_evidence > tone.log_evidence for swing in same) else tone


def _at_line(tone: Tone | None, swings: Sequence[Swing], recordings: Sequence[Recording]) -> list[Swing]:
    """What goes to and fro in the slow flow as often as a line at the carrier, to a bin of the shortest record."""
    if tone is None or tone.name != "mains_pickup":
        return []
    bin_hz = 1.0 / min(r.duration_s for r in plain_records(recordings))
    return [swing for swing in swings if abs(tone.frequency_hz - swing.frequency_hz) < bin_hz]


def _driven_line(tone: Tone | None, recordings: Sequence[Recording], linear: Linear) -> Unknown | None:
    """What the columns of the drives say all of."""
    if tone is None or tone.name != "mains_pickup" or not is_driven(recordings, linear, tone.frequency_hz):
        return None
    form = f"drives that go to and fro at {tone.frequency_hz:.3g} Hz, by a command of their own or by what they answer"
    return Unknown("electronics or environment", "in phase", form, "time", "reference_spur", 2.0 * tone.log_evidence)


def _rippling_gain(tone: Tone | None, swing: tuple[float, float] | None) -> Unknown | None:
    if tone is None or (swing is None and not tone.of_wave):
        return None
    what, phase = ("gain", "in phase") if swing is None else ("phase", "in quadrature")
    form = f"x times a {what} that goes to and fro at {tone.frequency_hz:.3g} Hz"
    return Unknown("drive or pick-off", phase, form, "time", tone.name, 2.0 * tone.log_evidence)


def _rippling_drive(line: OpenLine | None) -> Unknown | None:
    if line is None:
        return None
    what = {None: "a gain or a phase", False: "a gain", True: "a phase"}[line.of_phase]
    form = f"u times {what} that goes to and fro at {line.frequency_hz:.3g} Hz by {line.share:.2g}"
    phase = "in quadrature" if line.of_phase else "in phase"
    return Unknown("drive", phase, form, "time", "reference_spur" if line.of_phase else "drive_gain_flicker", 2.0 * line.log_evidence)


def _noisy_clock(growth: NoiseGrowth | None) -> Unknown | None:
    if growth is None or growth.clock_sigma < SIGMA:
        return None
    return Unknown("electronics", "in quadrature", "white noise in proportion to x", "amplitude", "amplitude_noise", growth.clock_sigma**2)


def _standing(name: str, present: set[str], alike: dict[str, str], growth: NoiseGrowth | None, heard: bool, sampled: bool) -> Standing:
    effect = EFFECTS[name]
    limit, status = None, "excluded"
    if name in present:
        status = "present"
    elif name in alike:
        status = f"like {alike[name]}"
    elif name in SAMPLED:
        status = "excluded" if sampled else "not testable"
    elif name in _NOT_TESTABLE or (name == "amplitude_noise" and growth is None) or not heard:
        status = "not testable"
    elif name == "amplitude_noise" and growth is not None:
        limit = Quantity(math.sqrt(SEEN) * growth.gain_per_rthz_limit, growth.gain_per_rthz_limit, effect.parameters[0].unit)
    return Standing(name, effect.title, effect.location, status, limit, 0.0, 0.0, 0.0)
