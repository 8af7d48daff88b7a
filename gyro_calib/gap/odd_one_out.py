"""A recording whose columns do not mean what those of the others mean: swapped axes, a wrong sign, conjugate envelopes, millivolts.

Every recording with a wave is foretold by a linear device that is fitted to all the others, in blocks of a tenth of a second. What is asked
of it knows neither frequency nor azimuth: how fast the amplitude goes, and how fast the wave turns and opens. Healthy recordings and ones
with strong effects miss that by some hundredths of what acts; one with a wrong sign misses it by once or twice, and where turning the sign
back mends it, the sign is what was wrong; unless one device obeys all recordings as well as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..recording.applied_rate import applied_rate, is_turned
from ..recording.recording import Recording
from .parts import turned

__all__ = ["check_alike"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Change = Callable[[ComplexArray], ComplexArray]
#: length of a block [s]; fewest rows of a recording, and fewest recordings that tell what one must be
_BLOCK_S, _FEWEST_ROWS, _FEWEST = 0.1, 200, 4
#: share of what acts that is missed from which on a recording is unlike the others; what a change must leave to be its cause, and share of
#: what one device for all recordings misses, as they are, that it may miss once one of them is changed
_UNLIKE, _MENDED, _BETTER = 0.5, 0.1, 0.5
#: from here on it is less like them than one at their temperature is; what a change must leave of that, of a device that the others tell
#: and of one for all, and over what they miss themselves
_LESS_LIKE, _LEAVES, _USUAL = 0.01, 0.07, 2.0
#: what one that is warmed or turned may leave instead: of a practice ring's damping 0.014 when warmed, of a table's log 0.028
_ELSEWHERE = 0.03
#: size of columns in another unit over the usual one
_OTHER_UNIT = 0.03
#: farther from the others' temperature [K] the damping alone misses that
_WARMED_K = 2.0
#: changes whose one device misses no more than so many times the least are as good as each other; and which of them may be the simplest
_AS_GOOD, _NEARLY = 1.5, 1.1
#: log of the ratio of what is missed, by row, from which on a change of all recordings is what they need: of real effects it was 0.013 at
#: most, of one axis's conjugate pick-offs of four hemispheres 0.06 to 0.47, of a small part of drives 2.5; share of the most that is near
_ALL_BETTER, _NEARLY_ALL = 0.04, 0.98
#: pull of what nothing tells towards zero, over the equations of one recording
_RIDGE = 1e-6


class Blocks(NamedTuple):
    """Means of blocks: V, V', V times how far the reference stands from its median, u, each (n, 2) complex; rate (n,) [rad/s]."""

    pick: ComplexArray
    change: ComplexArray
    away: ComplexArray
    drive: ComplexArray
    rate: FloatArray

    @property
    def speed(self) -> ComplexArray:
        """L[V] of the reference's frame: conjugate columns meet the same reference."""
        return self.change + 1j * self.away


@dataclass(frozen=True)
class _Mend:
    """What may have been done to columns, undone."""

    words: str
    pick: Change | None = None
    drive: Change | None = None
    #: whether it leaves the columns' sizes where they were: what takes an axis away, or names one after the other, mends what is small
    keeps: bool = True
    #: what it multiplies columns by, and whose
    scale: float = 1.0
    axes: tuple[int, ...] = (0, 1)

    def __call__(self, b: Blocks) -> Blocks:
        if self.pick is not None:
            b = b._replace(pick=self.pick(b.pick), change=self.pick(b.change), away=self.pick(b.away))
        return b if self.drive is None else b._replace(drive=self.drive(b.drive))


def _on(axes: str, change: Change) -> Change:
    """A change of the columns of these axes alone."""
    held = np.array([a in axes for a in "xy"])
    return lambda z: np.where(held, change(z), z)


def _mends() -> list[_Mend]:
    changes: tuple[tuple[str, Change, float], ...] = (
        ("the sign of the {} looks wrong. Turn it", lambda z: -z, 1.0),
        ("c and s of the {} look swapped. Swap them back", lambda z: 1j * z.conj(), 1.0),
        ("the s of the {} look to have the wrong sign (c + i s, signal = c cos phi - s sin phi). Turn it", lambda z: z.conj(), 1.0),
        ("the c of the {} look to have the wrong sign (c + i s, signal = c cos phi - s sin phi). Turn it", lambda z: -z.conj(), 1.0),
        ("the {} look like mV. Give them in volts", lambda z: 1e-3 * z, 1e-3),
        ("the {} look like kV. Give them in volts", lambda z: 1e3 * z, 1e3),
        ("the {} look like rms volts. Give peaks: multiply by sqrt(2)", lambda z: math.sqrt(2.0) * z, math.sqrt(2.0)),
        ("the {} look half as large as they are. Double them", lambda z: 2.0 * z, 2.0),
        ("the {} look twice as large as they are, as from peak to peak. Halve them", lambda z: 0.5 * z, 0.5),
    )
    found = []
    for words, change, scale in changes:
        keeps = max(scale, 1.0 / scale) < 1.0 / _OTHER_UNIT
        for k, axis in enumerate("xy"):
            found.append(_Mend(words.format(f"{axis} drive columns"), None, _on(axis, change), keeps, scale, (k,)))
            # twice or half as large they were far from their set point
            if scale not in (2.0, 0.5):
                found.append(_Mend(words.format(f"{axis} pick-off columns"), _on(axis, change), None, keeps, scale, (k,)))
        # drives times a number are pick-offs over it, and where the phase of the pick-offs is held, conjugate ones are what they were
        found.append(_Mend(words.format("drive columns (or the pick-off columns)"), None, change, keeps, scale))
        if scale == 1.0:
            found.append(_Mend(words.format("pick-off columns"), change, None, keeps))

    def swap(z: ComplexArray) -> ComplexArray:
        return z[:, ::-1]

    return [
        *found,
        # c and s swapped in all of them are this and a quarter of a cycle, which no equation sees
        _Mend("the s of all columns look to have the wrong sign, or c and s look swapped. Turn it, or swap them", np.conj, np.conj),
        _Mend("the drive columns of x and y look swapped. Swap them back", drive=swap, keeps=False),
        _Mend("the pick-off columns of x and y look swapped. Swap them back", pick=swap, keeps=False),
        _Mend("all columns of x and y look swapped. Swap them back", swap, swap, keeps=False),
    ]


def check_alike(recordings: Sequence[Recording], angular_gain: float) -> None:
    """Refuse a recording that obeys the equations of the others only once its columns are changed.

    Parameters
    ----------
    recordings : sequence of Recording
    angular_gain : float
        kappa of the factory.

    Raises
    ------
    DataError
        Names the recording, by how much it misses, and the change that mends it.
    """
    waves = [r for r in recordings if r.command.mode != "loops_off" and len(r) >= _FEWEST_ROWS]
    if sum(not is_turned(r) for r in waves) < _FEWEST:
        return
    side_by_side = _Waves.of(waves, angular_gain)
    found = [mended for place in range(len(waves)) for mended in side_by_side.mended(place)]
    if not found:
        side_by_side.check_together()
        return
    # one wrong recording spoils what is foretold of the others, too: the cause is what makes all of them those of one device, and of
    # changes that do so about as well the one after which least is missed, or the simplest of those that come near
    good = [m for m in found if m.with_it < _AS_GOOD * min(m.with_it for m in found)]
    cause = next(m for m in good if m.left < _NEARLY * min(m.left for m in good))
    raise DataError(
        f"Recording {cause.label!r} must obey the equations of the other {cause.others}, but misses {cause.missed:.2g} of what acts, and "
        f"only {cause.left:.2g} once changed: {cause.words}, or leave it out."
    )


class _Mended(NamedTuple):
    """A recording that a change mends: what it misses of the device of so many others, what then, and what any misses of one for all."""

    label: str
    words: str
    missed: float
    left: float
    with_it: float
    others: int


@dataclass(frozen=True)
class _Waves:
    """Recordings with a wave, what each says of the device, and which are turned by a table or warmed."""

    recordings: Sequence[Recording]
    blocks: Sequence[Blocks]
    equations: Sequence[_Equations]
    turned: Sequence[bool]
    warmed: NDArray[np.bool_]
    angular_gain: float

    @classmethod
    def of(cls, waves: Sequence[Recording], angular_gain: float) -> _Waves:
        blocks = [_blocks(r) for r in waves]
        equations = [_Equations.of(b, angular_gain) for b in blocks]
        return cls(waves, blocks, equations, [is_turned(r) for r in waves], _warmed(waves), angular_gain)

    @cached_property
    def at_rest(self) -> list[_Equations]:
        return [e for e, turned in zip(self.equations, self.turned, strict=True) if not turned]

    @cached_property
    def of_all(self) -> FloatArray:
        return _device_of(self.at_rest)

    @cached_property
    def usual(self) -> float:
        return float(np.median([e.missed(self.of_all) for e in self.at_rest]))

    def mended(self, place: int) -> list[_Mended]:
        """Changes after which a recording, unlike the others as it is, is like them."""
        own, blocks, turned = self.equations[place], self.blocks[place], self.turned[place]
        others = [e for e in self.at_rest if e is not own]
        device = _device_of(others)
        if (missed := own.missed(device)) < _LESS_LIKE:
            return []
        worst = _worst([*others, own])
        # that the table turned the other way, or the columns of all recordings do, is asked of the device that is fitted to all of them
        if turned and _worst([*others, _Equations.of(blocks._replace(rate=-blocks.rate), self.angular_gain)]) < _MENDED * worst:
            return []
        found = []
        for mend in _mends():
            mended = _Equations.of(mend(blocks), self.angular_gain)
            left, with_it = mended.missed(device), _worst([*others, mended])
            # drives that only a table moves the others tell nothing of: then it is one device for all that says what it mends
            if not (left < _MENDED * min(missed, 1.0) or (turned and with_it < _MENDED * worst)):
                continue
            # the others may leave open what it alone tells (x held but once with a side band): then one device is as good as it is
            far = missed > _UNLIKE and with_it < _BETTER * worst and _has_that_size(mend, self.blocks, place)
            near = self._is_near(mend, place, missed, left)
            if far or (near and mended.missed(_device_of([*others, mended])) < _MENDED * own.missed(self.of_all)):
                found.append(_Mended(self.recordings[place].label, mend.words, missed, left, with_it, len(others)))
        return found

    def _is_near(self, mend: _Mend, place: int, missed: float, left: float) -> bool:
        # a damping that is another when warm takes drives of another size
        if not mend.keeps or (self.warmed[place] and mend.scale != 1.0):
            return False
        elsewhere = self.warmed[place] or self.turned[place]
        return left < min(_ELSEWHERE if elsewhere else _USUAL * self.usual, _LEAVES * missed)

    def check_together(self) -> None:
        """Refuse a campaign whose recordings obey one device far better once all of them are changed alike.

        A drive's c and s swapped, or one of them with the wrong sign, are each other and a turn of its gain, which theory.md has near -i.
        """
        rows = np.array([len(e.y) for e in self.at_rest])
        resting = [b for b, turned in zip(self.blocks, self.turned, strict=True) if not turned]
        found = []
        for mend in _mends():
            if mend.scale != 1.0 or not mend.keeps:
                continue
            mended = [_Equations.of(mend(b), self.angular_gain) for b in resting]
            better = float(rows @ np.log(_missed(self.at_rest) / _missed(mended)))
            if better > _ALL_BETTER * rows.sum():
                found.append((better, _off_drive(_device_of(mended)), mend.words))
        if found:
            most = max(f[0] for f in found)
            words = min((f for f in found if f[0] > _NEARLY_ALL * most), key=lambda f: f[1])[2]
            raise DataError(f"Recordings must obey the equations of one device, but do so far better with all of them changed: {words}.")


def _missed(equations: Sequence[_Equations]) -> FloatArray:
    device = _device_of(equations)
    return np.array([e.missed(device) for e in equations])


def _off_drive(device: FloatArray) -> float:
    """By how much the gains of the drives are off -i, over themselves."""
    gains = [complex(device[8 + 2 * place], device[9 + 2 * place]) for place in (0, 3)]
    return max(abs(g / max(abs(g), 1e-300) + 1j) for g in gains)


def _has_that_size(mend: _Mend, blocks: Sequence[Blocks], place: int) -> bool:
    """Whether columns that are said to be in another unit are so much larger, or smaller, than those of the others."""
    if mend.scale == 1.0:
        return True
    if mend.keeps:
        # a set point or an attribute says as much of it
        return False
    columns = [(b.drive if mend.pick is None else b.pick)[:, list(mend.axes)] for b in blocks]
    sizes = np.array([float(np.sqrt(np.mean(np.abs(c) ** 2))) for c in columns])
    usual = float(np.median(np.delete(sizes, place)))
    return bool((sizes[place] < _OTHER_UNIT * usual) if mend.scale > 1.0 else (_OTHER_UNIT * sizes[place] > usual))


def _warmed(recordings: Sequence[Recording]) -> NDArray[np.bool_]:
    """Whether each is, or comes to, another temperature than most."""
    kelvins = np.array([float(np.mean(r.temperature_degc)) for r in recordings])
    moved = np.array([float(np.ptp(r.temperature_degc)) for r in recordings])
    return np.asarray(np.abs(kelvins - np.median(kelvins)) + moved > _WARMED_K)


def _blocks(r: Recording) -> Blocks:
    """Projections on squared sines that overlap by half; the derivative falls on the window."""
    half = max(2, round(0.5 * _BLOCK_S * r.sample_rate_hz))
    count = len(r) // half - 1
    phase = np.pi * (np.arange(2 * half) + 0.5) / (2 * half)
    value = np.sin(phase) ** 2
    total = float(value.sum())
    slope = np.pi / (2 * half) * r.sample_rate_hz * np.sin(2.0 * phase)

    def projected(x: ComplexArray, window: FloatArray) -> ComplexArray:
        parts = x[: (count + 1) * half].reshape(count + 1, half, -1)
        rising, falling = (np.einsum("mhk,h->mk", parts, w) for w in (window[:half], window[half:]))
        return np.asarray((rising[:-1] + falling[1:]) / total)

    away = (r.ref_omega_rad_s - np.median(r.ref_omega_rad_s))[:, None]
    rate = applied_rate(r)[0]
    return Blocks(
        projected(r.pick, value),
        -projected(r.pick, slope),
        projected(away * r.pick, value),
        projected(r.drive, value),
        projected(rate[:, None].astype(np.complex128), value)[:, 0].real,
    )


@dataclass(frozen=True)
class _Equations:
    """Regressors (3 n, 16) of the entries of A and G, what they must explain, and both as normal equations per row."""

    x: FloatArray
    y: FloatArray
    normal: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, b: Blocks, angular_gain: float) -> _Equations:
        """What blocks say of the device."""
        x, y = _rows(b, angular_gain)
        return cls(x, y, x.T @ x / len(y), x.T @ y / len(y))

    def missed(self, device: FloatArray) -> float:
        """What a device leaves over the largest of what acts: loss and coupling, drives, change."""
        half = self.x.shape[1] // 2
        parts = (self.x[:, :half] @ device[:half], self.x[:, half:] @ device[half:], self.y)
        largest = max(float(np.sqrt(np.mean(part**2))) for part in parts)
        return float(np.sqrt(np.mean((self.x @ device - self.y) ** 2))) / max(largest, 1e-300)


def _device_of(equations: Sequence[_Equations]) -> FloatArray:
    """A and G of the recordings together."""
    normal, right = np.sum([e.normal for e in equations], axis=0), np.sum([e.right for e in equations], axis=0)
    scale = np.sqrt(np.diag(normal)) + 1e-300
    return np.asarray(np.linalg.solve(normal / np.outer(scale, scale) + _RIDGE * np.eye(len(scale)), right / scale) / scale)


def _worst(equations: Sequence[_Equations]) -> float:
    """What is missed most of any recording by the device that they all tell."""
    return float(_missed(equations).max())


def _rows(b: Blocks, angular_gain: float) -> tuple[FloatArray, FloatArray]:
    """How fast the wave grows, turns and opens: by each entry of A and G, and in all."""
    square = np.sum(np.abs(b.pick) ** 2, axis=1)
    of_phase = np.conj(np.sum(b.pick**2, axis=1))
    of_phase = of_phase / np.maximum(np.abs(of_phase), 1e-300)

    def seen(speed: ComplexArray) -> FloatArray:
        along = np.sum(b.pick.conj() * speed, axis=1) / square
        across = of_phase * (b.pick[:, 0] * speed[:, 1] - b.pick[:, 1] * speed[:, 0]) / square
        return np.concatenate([along.real, across.real, across.imag])

    columns = []
    for source in (b.pick, b.drive):
        for a in range(2):
            for k in range(2):
                entry = np.zeros_like(source)
                entry[:, a] = source[:, k]
                columns += [seen(entry), seen(1j * entry)]
    turning = angular_gain * b.rate[:, None] * turned(b.pick)
    return np.stack(columns, axis=1), seen(b.speed + turning)
