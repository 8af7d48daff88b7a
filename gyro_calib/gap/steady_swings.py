"""Something goes to and fro at one frequency, one size and one phase on the device's clock through the whole campaign.

A bench that rocks, a supply that hums. In no record need it stand over the floor: all of them together tell it, for it has two unknowns
where :mod:`.swings` gives each record two of its own. Nor need it be away from what else moves there: a mean and a slope, the harmonics of
a side band and those of the wave's turning have sizes of their own beside it, and what is left of a cosine beside them tells its size.

What swings on one axis, the bias of its electrodes, is another in waves of another azimuth psi: along a wave ``cos^2 psi`` of it, or
``cos 2 psi`` where what both axes have alike is its own, across one ``sin 2 psi``, or of what stands between the axes ``cos 2 psi``.
Through a turned wave it has no one phase but in that shape. A gain of the x pick-off that rippled by 2.4e-5 at 0.85 Hz on a ring was none:
half of the waves lie on the other axis, whose quieter amplitude holds nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .evidence import CHANNELS
from .flow_left import FlowLeft
from .swings import HIGHEST_HZ, SHORTEST_S, Kind, Swing, is_imaged, kinds_of

__all__ = ["besides", "find_steady_swing", "floors_of", "swings_at_rest"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: fewest records that tell it; distance of the frequencies that are tried, over what one campaign tells apart; how many are tried at
#: most, of a campaign of hours the lower ones
_FEWEST, _STEP, _MOST = 6, 0.25, 40_000
#: records of a kind that tell their floor at its lowest bins too: of two of a hemisphere it was a thousandth of the resonance's wander
_OWN_FLOOR = 4
#: log evidence beyond the search from which on it is one (thirty campaigns without one came to 0.4 at most); how far below its law a floor
#: may be: a loop's hump makes it white, and nearer to the mean it is not
_MARGIN, _BELOW = 8.0, 0.01
#: what a record must tell over the most that one does: ten whose floor was believed a hundred times too high, and three others, were
#: thirteen far below their law with a log evidence of 8.6
_TELLS = 0.1
#: where other records say its frequency: fewest records that tell it again, log evidence, and how far the frequency is asked, in its sd
_FEWEST_AGAIN, _MARGIN_AGAIN, _SD_AGAIN = 4, 5.0, 3.0
#: harmonics of a side band, and of the azimuth, that have a size of their own in each record; what must be left of a cosine beside them;
#: bins about an image
_OF_SIDE_BAND, _OF_AZIMUTH, _LEAST_LEFT, _SKIRT_BINS = (1, 2, 3, 4, 5), (1, 2, 3, 4, 6, 8), 0.3, 1.5
#: share of the rows' rate within which their filter leaves a swing; share of the largest below which two of these are one
_PASSED, _ALIKE = 0.45, 1e-10
#: frequencies at which a record's transform is formed, in each of its bins: between them it is smooth; frequencies about the best one, and
#: how often
_FINE, _FINER, _FINER_TIMES = 16, 17, 2


#: how what swings goes with the azimuth, and in which channels that is asked; least of the shape in any record
_SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "": np.ones_like,
    "cos 2 psi": lambda psi: np.asarray(np.cos(2.0 * psi)),
    "sin 2 psi": lambda psi: np.asarray(np.sin(2.0 * psi)),
    "cos^2 psi": lambda psi: np.asarray(np.cos(psi) ** 2),
    "sin^2 psi": lambda psi: np.asarray(np.sin(psi) ** 2),
}
_ACROSS, _LEAST_SHAPE = ("precession", "quadrature"), 0.3
#: a swing in a shape counts for so much of its log evidence against one in none
_SHAPED = 0.8


@dataclass(frozen=True)
class _Heard:
    """What records hold of a swing ``Re z exp(2 pi i f t)``: ``H = (a z + b conj z) / 2``, over their floors.

    Parameters
    ----------
    H, b : ndarray, complex, shape (..., frequencies)
    a : ndarray, shape (..., frequencies)
        0 where a record tells nothing.
    """

    H: ComplexArray
    a: FloatArray
    b: ComplexArray

    def best(self) -> ComplexArray:
        """The likeliest z, 0 of a record that tells nothing."""
        det = self.a**2 - np.abs(self.b) ** 2
        return np.asarray(2.0 * (self.a * self.H - self.b * np.conj(self.H)) / np.where(det > 0.0, det, np.inf))

    def gain(self) -> FloatArray:
        """Log likelihood of that one over none."""
        return np.asarray(0.5 * np.real(np.conj(self.best()) * self.H))

    def together(self) -> _Heard:
        """Of all records one."""
        return _Heard(self.H.sum(axis=0), self.a.sum(axis=0), self.b.sum(axis=0))

    def part(self, records: NDArray[np.bool_], k: int) -> _Heard:
        """Of some records at one frequency."""
        return _Heard(self.H[records, k : k + 1], self.a[records, k : k + 1], self.b[records, k : k + 1])


class _Record:
    """What one record tells of swings, beside what else moves in it.

    Parameters
    ----------
    flow : FlowLeft
    shape : str
        How a swing goes with the azimuth.
    """

    def __init__(self, flow: FlowLeft, shape: str) -> None:
        self._flow = flow
        self._window = np.hanning(len(flow.azimuth_rad) + 2)[1:-1]
        self._besides = besides(flow, self._window)
        course = _SHAPES[shape](flow.azimuth_rad)
        self._shaped = self._window * course
        whole = float(self._shaped @ course)
        self._f, held = self._about_its_middle(self._shaped[:, None] * self._besides)
        # at twice a frequency the window alone hears next to nothing, but of the lowest ones
        twice = self._about_its_middle((self._shaped * course)[:, None])[1][::2, 0]
        twice = np.pad(twice, (0, len(held) - len(twice)))
        self._a, self._b = whole - np.sum(np.abs(held) ** 2, axis=1), twice - np.sum(held**2, axis=1)
        #: variance of what is heard, over the floor and a; what a must be for a swing to be told
        self._per_floor = max(float(self._shaped @ self._shaped) / max(whole, 1e-300), 1e-300) / flow.row_s
        self._least = _LEAST_LEFT * max(whole, _LEAST_SHAPE**2 * float(self._window.sum()))

    def heard(self, channel: str, grid: FloatArray, floor: FloatArray) -> _Heard:
        """Of a channel over its floor, shape (frequencies,)."""
        a, b = np.interp(grid, self._f, self._a), np.interp(grid, self._f, self._b)
        there = (a - np.abs(b) > self._least) & (grid < _PASSED / self._flow.row_s) & (floor > 0.0)
        there &= ~is_imaged(self._flow, grid, _SKIRT_BINS / self._flow.duration_s)
        x = self._flow.rate[channel]
        left = x - self._besides @ (self._besides.T @ (self._window * x))
        f, found = self._about_its_middle((self._shaped * left)[:, None])
        # turns from the middle to the zero of the device's clock
        middle_s = self._flow.start_s + 0.5 * (len(x) - 1) * self._flow.row_s
        clock = np.exp(-2j * np.pi * grid * middle_s)
        noise = np.where(there, floor, np.inf) * self._per_floor
        return _Heard(CubicSpline(f, found[:, 0])(grid) * clock / noise, a / noise, b * clock**2 / noise)

    def _about_its_middle(self, x: FloatArray) -> tuple[FloatArray, ComplexArray]:
        """Frequencies, and Fourier sums of columns with the record's middle as the zero of time: so they are smooth."""
        n = len(x)
        f = np.arange(_FINE * n // 2 + 1) / (_FINE * n * self._flow.row_s)
        kept = f <= 2.0 * HIGHEST_HZ + 1.0 / self._flow.duration_s
        moved = np.exp(1j * np.pi * f * (n - 1) * self._flow.row_s)
        return f[kept], np.asarray(np.fft.rfft(x, _FINE * n, axis=0)[kept] * moved[kept, None])


def find_steady_swing(flows: Sequence[FlowLeft]) -> Swing | None:
    """The steady swing of most evidence, if it is one.

    Parameters
    ----------
    flows : sequence of FlowLeft
    """
    long_enough = [flow for flow in flows if flow.duration_s >= SHORTEST_S]
    if len(long_enough) < _FEWEST:
        return None
    span_s = max(f.start_s + f.duration_s for f in long_enough) - min(f.start_s for f in long_enough)
    step = _STEP / span_s
    grid = np.asarray(np.arange(1.0, min(HIGHEST_HZ / step, _MOST)) * step, dtype=np.float64)
    asked = [(channel, shape) for shape in _shapes(long_enough) for channel in CHANNELS if shape != "sin 2 psi" or channel in _ACROSS]
    searched = math.log(len(asked) * grid.size)
    records = {shape: {id(flow): _Record(flow, shape) for flow in long_enough} for shape in {shape for _, shape in asked}}
    kinds = {channel: kinds_of(long_enough, channel) for channel in CHANNELS}
    found = [
        replace(swing, shape=shape)
        for channel, shape in asked
        if (swing := _of_channel(kinds[channel], records[shape], grid, channel, searched)) is not None
    ]
    # one of a wave that turns on from record to record is one at another frequency in a shape
    return max(found, key=lambda swing: swing.log_evidence * (_SHAPED if swing.shape else 1.0), default=None)


def swings_at_rest(flows: Sequence[FlowLeft], swing: Swing) -> bool:
    """Whether records whose wave stands still hold a steady swing as well, at the frequency that all of them say.

    Only its sd of frequency is searched, so fewer of them tell it than would find it: six at rest of a twenty-eighth plant, of which one
    alone may have been disturbed, do not find a sway of 6.7e-5 rad/s that stands 40 to 160 times over the floor of the four static ones.

    Parameters
    ----------
    flows : sequence of FlowLeft
    swing : Swing
        As :func:`find_steady_swing` has it.
    """
    still = [flow for flow in flows if flow.is_still and flow.duration_s >= SHORTEST_S]
    kinds = kinds_of(still, swing.channel)
    records = {id(flow): _Record(flow, swing.shape) for kind in kinds for flow in kind.flows}
    if len(records) < _FEWEST_AGAIN:
        return False
    grid = swing.frequency_hz + _SD_AGAIN * swing.frequency_sd_hz * np.linspace(-1.0, 1.0, _FINER)
    heard = _heard(kinds, records, grid[grid > 0.0], swing.channel)
    best = int(np.argmax(_evidence(heard)))
    told = heard.a[:, best] > 0.0
    return int(told.sum()) >= _FEWEST_AGAIN and _without_the_loudest(heard, told, best) > _MARGIN_AGAIN


def _without_the_loudest(heard: _Heard, told: NDArray[np.bool_], k: int) -> float:
    """Log evidence at a frequency without the record that says most: one alone may have been disturbed."""
    return min(float(_evidence(heard.part(told & (np.arange(told.size) != j), k))[0]) for j in np.flatnonzero(told))


def _shapes(flows: Sequence[FlowLeft]) -> list[str]:
    """Those in which waves of these azimuths hold something, each unlike the others: on one axis alone all are one."""
    squares = {shape: np.array([float(np.mean(of(flow.azimuth_rad) ** 2)) for flow in flows]) for shape, of in _SHAPES.items()}
    held = [shape for shape, square in squares.items() if np.count_nonzero(square > _LEAST_SHAPE**2) >= _FEWEST]
    mean = [float(np.mean(np.cos(2.0 * flow.azimuth_rad))) for flow in flows]
    return [shape for shape in held if shape in ("", "sin 2 psi") or float(np.ptp(mean)) > _LEAST_SHAPE]


def _of_channel(kinds: Sequence[Kind], records: Mapping[int, _Record], grid: FloatArray, channel: str, searched: float) -> Swing | None:
    if sum(len(kind.flows) for kind in kinds) < _FEWEST:
        return None
    coarse = _heard(kinds, records, grid, channel)
    evidence = _evidence(coarse)
    best = int(np.argmax(evidence))
    if evidence[best] - searched <= 0.0:
        return None
    # beside a frequency that is a part of a step away much is left of it, and its sd may be a tenth of a step
    fine, middle, step = grid, float(grid[best]), float(grid[1] - grid[0])
    for _ in range(_FINER_TIMES):
        fine = middle + np.linspace(-1.0, 1.0, _FINER) * step
        fine = fine[fine > 0.0]
        heard = _heard(kinds, records, fine, channel)
        best = int(np.argmax(_evidence(heard)))
        middle, step = float(fine[best]), float(fine[1] - fine[0])
    told = heard.a[:, best] > 0.0
    if int(told.sum()) < _FEWEST:
        return None
    beyond = _without_the_loudest(heard, told, best) - searched
    if beyond <= _MARGIN:
        return None
    whole = heard.part(told, best).together()
    swing, size_sd = complex(whole.best()[0]), float(np.sqrt(2.0 / whole.a[0]))
    size = abs(swing)
    # the bound of a line in a record that is as long as the campaign
    frequency_sd_hz = math.sqrt(3.0) / math.pi * (grid[1] - grid[0]) / _STEP * size_sd / size
    # of a phase in the middle, and what a frequency that is so uncertain, or tried so coarsely, turns it by until the clock's zero
    middle_s = float(np.mean([flow.start_s + 0.5 * flow.duration_s for kind in kinds for flow in kind.flows]))
    to_zero = 2.0 * math.pi * middle_s * math.hypot(frequency_sd_hz, 0.5 * float(fine[1] - fine[0]))
    return Swing(
        channel,
        float(fine[best]),
        beyond,
        int(told.sum()),
        size,
        size_sd,
        frequency_sd_hz,
        float(np.angle(swing)),
        math.hypot(size_sd / size, to_zero),
    )


def _evidence(heard: _Heard) -> FloatArray:
    """Log evidence of one swing of all records over floors that are other there: as a resonance's that wanders, higher.

    Where the floors' common size is free that is the F test's: of N records noise gains ``ln(whole/left) > x`` by ``exp(-(N - 1) x)``.
    """
    count = np.maximum(np.sum(heard.a > 0.0, axis=0), 1)
    whole = np.sum(heard.gain(), axis=0)
    left = np.maximum(whole - heard.together().gain(), 0.0)
    higher, beside = np.maximum(whole / count, _BELOW), np.maximum(left / count, _BELOW)
    return np.asarray((count - 1) * np.log(higher / beside) + whole / higher - left / beside)


def _heard(kinds: Sequence[Kind], records: Mapping[int, _Record], grid: FloatArray, channel: str) -> _Heard:
    """By record over its floor, shape (records, frequencies) each; of those that tell something beside the others."""
    flows = [flow for kind in kinds for flow in kind.flows]
    found = [records[id(flow)].heard(channel, grid, floor) for flow, floor in zip(flows, floors_of(kinds, grid), strict=True)]
    a = np.array([h.a for h in found])
    tells = a > _TELLS * a.max(axis=0)
    return _Heard(np.array([h.H for h in found]) * tells, a * tells, np.array([h.b for h in found]) * tells)


def besides(flow: FlowLeft, window: FloatArray) -> FloatArray:
    """What else moves in a record, orthonormal under its window, shape (n, k)."""
    n = len(window)
    place = np.linspace(-1.0, 1.0, n)
    columns = [np.ones(n), place]
    angles = []
    if flow.excited_hz > 0.0:
        angles += [2.0 * np.pi * k * flow.excited_hz * flow.row_s * np.arange(n) for k in _OF_SIDE_BAND]
    if not flow.is_still:
        angles += [k * flow.azimuth_rad for k in _OF_AZIMUTH]
    for angle in angles:
        columns += [np.cos(angle), np.sin(angle)]
    together = np.column_stack(columns)
    size, axes = np.linalg.eigh(together.T @ (window[:, None] * together))
    apart = size > _ALIKE * size[-1]
    return np.asarray(together @ (axes[:, apart] / np.sqrt(size[apart])))


def floors_of(kinds: Sequence[Kind], grid: FloatArray) -> FloatArray:
    """By record. Of a kind of few not below that of most records: no bin near the mean tells it, and all are of one device that wanders."""
    counts = [len(kind.flows) for kind in kinds]
    floors = np.repeat([kind.law(grid) for kind in kinds], counts, axis=0)
    own = np.repeat([kind.tells_floor(grid, _OWN_FLOOR) for kind in kinds], counts, axis=0)
    usual = np.nanmedian(np.where(own.any(axis=0) & ~own, np.nan, floors), axis=0)
    return np.where(own, floors, np.maximum(floors, usual))
