"""Document 003: the scale factor from the ratio of the drive gains, and a drive gain that is measured in the field.

The factory stores rho = Gmx/Gmy, which stays while each gain drifts. In the field one gain is measured against the pick-offs, as the
electromechanical rate per volt of drive and volt of pick-off, ``g_x = Gmx Gd / (2 m omega) = |G_xx|`` of the slow flow:

* stiffness control: drive = CR x pick-off in phase with the displacement moves the frequency, ``V = |dw/dCR| = g_x`` (Eq. 6), V/Gfe =
kappa Ac rho (9);
* amplitude control: drive = CA x pick-off in phase with the velocity, down to a threshold and up again,
  ``C/CA = (1/T1 + 1/T2)/(2 CA) = g_x`` (12), C/Gfe = kappa CA Ac rho (13);
* drive at twice the frequency: a constant CA acts in proportion to the amplitude already, ``C = CA Gmx/(2 m omega)`` (14-15): the same with
  the pick-off volt replaced by the nominal amplitude.

With Gfe = 1/S the scale factor is ``S_x = kappa Ac rho / g_x`` and, with y as the oscillator, ``S_y = -kappa Ac / (rho g_y)`` (theory.md
Eq. 7).

What biases it, and what is done here about it:

* loop latency L: the drive follows the amplitude of L ago, C is up by L C (1/T up by 0.05-0.2 %): the *recorded* drive over the
amplitude is used;
* detuning and Duffing (the frequency moves with a^2 while the amplitude moves; the PLL follows late): only the part of the drive in
phase with the
  velocity of the wave counts, a factor cos delta that is recorded;
* nonlinear damping 1/tau + c a^2: cancels in C when both legs run over the same amplitudes, and shifts 1/tau: a term c of its own;
* a pick-off that is not linear (1 + p a^2): C is up by 2 p <a^2>, does not cancel: a term of its own;
* a wave that is not exactly on the axis, at psi: the couplings act, 2 psi tan 2 delta: taken out with the drive chain where it is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Recording
from .drive_chain import DriveChain
from .stiffness_gain import stiffness_gain
from .wave import Wave, wave_coordinates
from .wave_drive import COUPLING_SD, block_means, effective_drive, off_axis, wave_off_axis, without_feedthrough

__all__ = ["RingResult", "off_axis", "reference_ratio", "ring_gain", "scale_factor", "stiffness_gain", "without_feedthrough"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: blocks over which the amplitude is averaged [s]
_RING_S = 0.4
#: share of the largest drive ratio from which on a leg is a leg, its least rows, rows whose ratio may be larger by chance
_LEG, _LEAST_ROWS, _SPIKES = 0.9, 8, 2
#: blocks that a leg has at least
_LEG_BLOCKS = 8
#: change of the drive ratio within a block, or to the next, over the largest, from which on it is being switched
_SWITCHED = 0.03
#: square of the drive ratio over the largest, below which the wave is being held, and how many steps of it show the feedthrough
_HELD, _HELD_STEPS = 0.5, 4
_NONLINEAR = ("nonlinear_damping", "pickoff_cubic")
#: chance of taking up a nonlinear term for nothing
_CHANCE = 1e-4


@dataclass(frozen=True)
class RingResult:
    """Ring-down and ring-up.

    Parameters
    ----------
    gain : Quantity
        g along the axis: electromechanical rate per V/V [1/s].
    decay_rate : Quantity
        1/tau at zero amplitude [1/s].
    document_gain : float
        ``(1/T1 + 1/T2)/(2 CA)`` from plain exponentials and the commanded CA [1/s].
    t1_s, t2_s : float
        Time constants of the two legs [s].
    nonlinear_damping, pickoff_cubic : Quantity or None
        c of ``1/tau + c a^2`` [1/(s V^2)] and p of ``V = v (1 + p v^2)`` [1/V^2], when the data asked for them.
    """

    gain: Quantity
    decay_rate: Quantity
    document_gain: float
    t1_s: float
    t2_s: float
    nonlinear_damping: Quantity | None
    pickoff_cubic: Quantity | None


def ring_gain(
    recordings: Sequence[Recording],
    axis: str,
    *,
    chain: DriveChain | None = None,
    cross_damping: float = 0.0,
    drive_amplitude_v: float | None = None,
    feedthrough: ComplexArray | None = None,
) -> RingResult:
    """Gain of one axis from ring-down and ring-up of a wave on it (document 003, second method).

    Parameters
    ----------
    recordings : sequence of Recording
        Modes ``ring_down`` and ``ring_up``; one recording may hold both legs.
    axis : {"x", "y"}
    chain : DriveChain, optional
        Drive chain as the controller sees it; without it the couplings are held to be zero to 5 mrad.
    cross_damping : float
        Real part of A_xy + A_yx [1/s], where it is known: a wave that drifts off the axis decays at another rate.
    drive_amplitude_v : float, optional
        Drives at twice the frequency: nominal amplitude [V].
    feedthrough : ndarray, shape (2, 2), complex, optional
        E, where it was measured: what the drives put straight onto the pick-offs is taken out first. On a ring, whose legs are too short
        to tell it from damping, it is 1e-4 of the gain.

    Raises
    ------
    CalibrationRefused
        No leg down or none up.
    """
    if feedthrough is not None:
        recordings = [without_feedthrough(r, feedthrough) for r in recordings]
    parts = [_ring_part(r, axis, chain, cross_damping, drive_amplitude_v) for r in recordings]
    legs = _legs(recordings, drive_amplitude_v)
    fit = _selected(parts)
    gain, gain_sd = fit.values["gain"]
    azimuth = float(np.mean([p.off_axis for p in parts]))
    if chain is None:
        gain_sd = math.hypot(gain_sd, gain * 2.0 * abs(azimuth) * COUPLING_SD)
    decay, decay_sd = fit.values["decay"]
    return RingResult(
        gain=Quantity(gain, gain_sd, "1/s"),
        decay_rate=Quantity(-decay, decay_sd, "1/s"),
        document_gain=legs[2],
        t1_s=legs[0],
        t2_s=legs[1],
        nonlinear_damping=_found(fit, "nonlinear_damping", -1.0, "1/(s V^2)"),
        pickoff_cubic=_found(fit, "pickoff_cubic", 1.0, "1/V^2"),
    )


def _found(fit: _RingFit, name: str, factor: float, unit: str) -> Quantity | None:
    return Quantity(*fit.values[name], unit).scaled(factor, unit) if name in fit.values else None


def _selected(parts: list[_RingPart]) -> _RingFit:
    """``ln V = const - int(1/tau + c a^2) + g int(r) + f (r + g int(r^2)) + p a^2``, integrals so that nothing is differentiated; c and p
    as far as the data ask. f is the feedthrough (V = v + E u, so that V/v = 1 + f r with f = -Im E, and v is smaller than what r was taken
    over).
    """
    linear = ["decay", "gain"]
    # of one ratio, up and down, the feedthrough's part is even and passes for damping: the gain does without it
    squares = np.concatenate([p.columns["drive"][1:][p.steady] ** 2 for p in parts])
    if np.count_nonzero(squares < _HELD * squares.max(initial=0.0)) >= _HELD_STEPS:
        linear.append("feedthrough")
    plain = _fit(parts, linear)
    single = min((_fit(parts, [*linear, name]) for name in _NONLINEAR), key=lambda fit: fit.squares)
    both = _fit(parts, [*linear, *_NONLINEAR])
    one, two = float(chdtri(1, _CHANCE)), float(chdtri(2, _CHANCE))
    if plain.chi2_over(both) > two and single.chi2_over(both) > one:
        return both
    return single if plain.chi2_over(single) > one else plain


@dataclass(frozen=True)
class _RingPart:
    """Thinned regressors of one recording: ln a and the integrals of what changes it; and which of their steps count."""

    log_amplitude: FloatArray
    columns: dict[str, FloatArray]
    steady: NDArray[np.bool_]
    off_axis: float


def _ring_part(
    recording: Recording, axis: str, chain: DriveChain | None, cross_damping: float, drive_amplitude_v: float | None
) -> _RingPart:
    wave = wave_coordinates(recording)
    row_s = 1.0 / recording.sample_rate_hz
    a = wave.amplitude_v
    ratio = effective_drive(wave, axis, chain).imag / (wave.amplitude_v if drive_amplitude_v is None else drive_amplitude_v)
    off = wave_off_axis(wave, axis)

    def passed(values: FloatArray) -> FloatArray:
        return np.concatenate([[0.0], np.cumsum(0.5 * row_s * (values[1:] + values[:-1]))])

    width = max(2, min(round(_RING_S * recording.sample_rate_hz), _leg_rows(ratio).size // _LEG_BLOCKS))
    return _RingPart(
        log_amplitude=block_means(np.log(a) - passed(0.5 * cross_damping * np.sin(2.0 * wave.azimuth_rad)), width),
        columns={
            "decay": block_means(passed(np.ones_like(a)), width),
            "gain": block_means(passed(ratio), width),
            "nonlinear_damping": block_means(passed(a**2), width),
            # ln V = ln v + p v^2, and v is what obeys the equation
            "pickoff_cubic": block_means(a**2, width),
            "drive": block_means(ratio, width),
            "drive_squared": block_means(passed(ratio**2), width),
        },
        steady=_steady(ratio, width),
        off_axis=off,
    )


def _full_ratio(ratio: FloatArray) -> float:
    """Size of the ratio on the legs: the largest but for a few rows, however short the legs are in a recording."""
    return float(np.sort(np.abs(ratio))[-min(_SPIKES + 1, ratio.size)])


def _leg_rows(ratio: FloatArray) -> NDArray[np.intp]:
    return np.flatnonzero(np.abs(ratio) > _LEG * _full_ratio(ratio))


def _steady(ratio: FloatArray, width: int) -> NDArray[np.bool_]:
    """Steps between blocks in which the drive is not switched.

    Where it is, amplitude and drive are means over rows whose filter does not commute with their ratio: 1e-4 of a gain within 0.1 s.
    """
    count = ratio.size // width
    change = np.ptp(ratio[: count * width].reshape(count, width), axis=1)
    jump = np.abs(np.diff(block_means(ratio, width)))
    limit = _SWITCHED * float(np.max(np.abs(ratio)))
    return np.asarray((change[1:] < limit) & (change[:-1] < limit) & (jump < limit))


def _drive_ratio(wave: Wave, drive_amplitude_v: float | None) -> FloatArray:
    """Drive in phase with the velocity of the wave over what it acts in proportion to."""
    volts = wave.drive_along.imag
    return np.asarray(volts / (wave.amplitude_v if drive_amplitude_v is None else drive_amplitude_v))


@dataclass(frozen=True)
class _RingFit:
    """Coefficients with standard deviations, and the residual in units of its own noise."""

    values: dict[str, tuple[float, float]]
    squares: float
    noise: float

    def chi2_over(self, richer: _RingFit) -> float:
        """How much more this fit leaves than a richer one, in units of the richer one's noise."""
        return (self.squares - richer.squares) / max(richer.noise, 1e-300)


def _fit(parts: list[_RingPart], names: list[str]) -> _RingFit:
    """Least squares of the increments of ln a: force noise walks in the amplitude, so increments are what is independent."""
    gain = 0.0
    for _ in range(3 if "feedthrough" in names else 1):
        fit = _solved(parts, names, gain)
        gain = fit.values["gain"][0]
    return fit


def _solved(parts: list[_RingPart], names: list[str], gain: float) -> _RingFit:
    design, target = [], []
    for part in parts:
        columns = {**part.columns, "feedthrough": part.columns["drive"] + gain * part.columns["drive_squared"]}
        design.append(np.diff(np.column_stack([columns[name] for name in names]), axis=0)[part.steady])
        target.append(np.diff(part.log_amplitude)[part.steady])
    matrix, values = np.vstack(design), np.concatenate(target)
    scale = np.linalg.norm(matrix, axis=0)
    solution, *_ = np.linalg.lstsq(matrix / scale, values, rcond=None)
    left = values - matrix / scale @ solution
    noise = float(left @ left) / max(values.size - len(names), 1)
    spread = np.sqrt(noise * np.diag(np.linalg.inv((matrix / scale).T @ (matrix / scale)))) / scale
    found = {name: (float(v), float(s)) for name, v, s in zip(names, solution / scale, spread, strict=True)}
    return _RingFit(found, float(left @ left), noise)


def _legs(recordings: Sequence[Recording], drive_amplitude_v: float | None) -> tuple[float, float, float]:
    """T1, T2 and the gain of plain exponentials with the commanded CA, as the document reads them."""
    rates: dict[int, float] = {}
    commanded: dict[int, float] = {}
    for recording in recordings:
        wave = wave_coordinates(recording)
        ratio = _drive_ratio(wave, drive_amplitude_v)
        largest = _full_ratio(ratio)
        for sign in (-1, 1):
            rows = sign * ratio > _LEG * largest
            if rows.sum() >= _LEAST_ROWS and _is_leg(recording, sign):
                rates[sign] = float(np.polyfit(wave.t[rows] - wave.t[0], np.log(wave.amplitude_v[rows]), 1)[0])
                commanded[sign] = _commanded(recording, sign) or float(np.median(ratio[rows]))
    if set(rates) != {-1, 1}:
        raise CalibrationRefused(
            "Ring-down must have a leg down and a leg up, but got "
            f"{', '.join('up' if s > 0 else 'down' for s in sorted(rates)) or 'none'}. Record modes ring_down and ring_up."
        )
    gain = (rates[1] - rates[-1]) / (commanded[1] - commanded[-1])
    return -1.0 / rates[-1], 1.0 / rates[1], gain


def _is_leg(recording: Recording, sign: int) -> bool:
    """A closed amplitude loop drives upwards too; only a commanded ratio makes a leg."""
    mode = recording.command.mode
    if isinstance(recording.extras.get("amplitude_control"), dict):
        return True
    return (mode == "ring_down" and sign < 0) or (mode == "ring_up" and sign > 0)


def _commanded(recording: Recording, sign: int) -> float | None:
    """CA as commanded [V/V], where the recording says."""
    schedule = recording.extras.get("amplitude_control")
    if isinstance(schedule, dict):
        value = schedule.get("gain_down" if sign < 0 else "gain_up")
        return float(value) if isinstance(value, int | float) else None
    value = recording.command.setpoints.amplitude_gain_v_per_v
    return sign * abs(value) if value else None


def reference_ratio(gain_x: Quantity, gain_y: Quantity, pickoff_ratio: Quantity) -> Quantity:
    """rho = Gmx/Gmy for the factory to store: from the gain of either axis and the pick-off ratio r (a rate table gives it)."""
    value = pickoff_ratio.value * gain_x.value / gain_y.value
    parts = [q.sd / q.value for q in (gain_x, gain_y, pickoff_ratio)]
    return Quantity(value, abs(value) * math.sqrt(sum(p * p for p in parts)), "1")


def scale_factor(
    gain: Quantity, axis: str, ratio: Quantity, kappa: float, amplitude_v: float, *, chain: DriveChain | None = None
) -> Quantity:
    """Corrected scale factor of force to rebalance [V/(rad/s)] from one measured gain (document 003, Eqs. 9 and 13).

    The document has no couplings. Where the drives couple (2 delta, 2 lambda) and the pick-offs are not square to one another, the ratio of
    the drive gains and that of the slow flow, ``r |G_xx| / |G_yy|``, differ by the product of both (some 10 ppm to 100 ppm): nothing when
    :func:`reference_ratio` made the factory's ratio or a compensation is in force, an uncertainty otherwise.

    Parameters
    ----------
    gain : Quantity
        g of the oscillator's axis [1/s], from either method.
    axis : {"x", "y"}
        Oscillator.
    ratio : Quantity
        rho = Gmx/Gmy of the factory.
    kappa : float
        Angular gain: no self-calibration sees it.
    amplitude_v : float
        Ac [V].
    chain : DriveChain, optional
        Uncompensated couplings, for a factory's ratio of the physical gains.
    """
    value = kappa * amplitude_v * (ratio.value if axis == "x" else -1.0 / ratio.value) / gain.value
    aside = 0.0
    if chain is not None:
        aside = COUPLING_SD * float(np.hypot(chain.matrix[0, 1], chain.matrix[1, 0]))
    relative = math.sqrt((gain.sd / gain.value) ** 2 + (ratio.sd / ratio.value) ** 2 + aside**2)
    return Quantity(value, abs(value) * relative, "V/(rad/s)")
