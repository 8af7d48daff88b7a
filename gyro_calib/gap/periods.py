"""Something goes to and fro as slowly as a record lasts, and as no cosine: a heater that a thermostat switches, a supply that hiccups.

Within one record its harmonics are one or two bins apart or less, and none is told from the others, nor from a mean and a slope: a search
cosine by cosine (:mod:`.steady_swings`) finds each record disturbed by all but the one that it asks for. Here a mean waveform of a few
harmonics is asked for, the same on the device's clock in every record. What of a record's disturbance is common is a share of its power;
records moved against one another at random on the clock tell how large that share is by chance, whatever their floors are like.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaln, hyp2f1

from .evidence import CHANNELS
from .flow_left import FlowLeft
from .steady_swings import besides, floors_of
from .swings import SHORTEST_S, Kind, Swing, kinds_of

__all__ = ["find_period"]

FloatArray = NDArray[np.float64]
#: harmonics of the waveform; slowest and fastest period, in records of the usual length; distance of the periods that are tried, over
#: what one campaign tells apart, and how many are tried at most, of a campaign of hours the slower ones
_HARMONICS, _SLOWEST, _FASTEST, _STEP, _MOST = 3, 3.0, 0.4, 0.25, 4000
#: rows of a record that are kept in the shortest cycle
_IN_A_CYCLE = 8.0
#: mean of the phases at which records begin, beyond which a period is that of the commands: what settles after each would have it too
_OF_COMMANDS = 0.6
#: fewest records that tell it, and log evidence beyond the search from which on it is one (67 without one came to 4.5 at most: chance, 4.2)
_FEWEST, _MARGIN = 8, 8.0
#: share of the largest below which two directions are one; random moves of the records; least chance that a double holds
_ALIKE, _MOVES, _LEAST_CHANCE = 1e-3, 400, 1e-280


@dataclass(frozen=True)
class _Told:
    """What records tell of a waveform, its sizes in units of its floor.

    Parameters
    ----------
    score : ndarray, shape (..., records, k)
        Towards the sizes that each asks for, ``k`` of cos and sin of every harmonic; before the records periods, or moves.
    information : ndarray, shape (..., records, k, k)
    """

    score: FloatArray
    information: FloatArray

    def each(self) -> FloatArray:
        """Power that each has of its own, shape (..., records)."""
        return _power(self.score, self.information)

    def common(self) -> FloatArray:
        """Power that is common, shape (...,)."""
        return _power(self.score.sum(axis=-2), self.information.sum(axis=-3))

    def moved(self, turns: FloatArray) -> _Told:
        """Each by shares of the period, shape (moves, records): what goes with cos and sin of the harmonics turns."""
        angles = 2.0 * np.pi * turns[..., None] * (1.0 + np.arange(_HARMONICS))
        turn = np.zeros((*turns.shape, 2 * _HARMONICS, 2 * _HARMONICS))
        k = np.arange(0, 2 * _HARMONICS, 2)
        turn[..., k, k] = turn[..., k + 1, k + 1] = np.cos(angles)
        turn[..., k, k + 1] = -np.sin(angles)
        turn[..., k + 1, k] = np.sin(angles)
        return _Told(np.squeeze(turn @ self.score[..., None], axis=-1), turn @ self.information @ turn.swapaxes(-1, -2))


def find_period(flows: Sequence[FlowLeft]) -> Swing | None:
    """The period of most evidence, if something has it.

    Parameters
    ----------
    flows : sequence of FlowLeft
    """
    long_enough = [flow for flow in flows if flow.duration_s >= SHORTEST_S]
    if len(long_enough) < _FEWEST:
        return None
    usual_s = float(np.median([flow.duration_s for flow in long_enough]))
    rare = [_rarely(flow, usual_s * _FASTEST / _HARMONICS / _IN_A_CYCLE) for flow in long_enough]
    span_s = max(f.start_s + f.duration_s for f in rare) - min(f.start_s for f in rare)
    step = _STEP / (span_s * _HARMONICS)
    grid = np.arange(1.0 / (_SLOWEST * usual_s), 1.0 / (_FASTEST * usual_s), step)[:_MOST]
    begun = np.exp(2j * np.pi * grid[:, None, None] * (1.0 + np.arange(_HARMONICS)) * np.array([[f.start_s] for f in rare]))
    grid = grid[np.abs(begun.mean(axis=1)).max(axis=1) < _OF_COMMANDS]
    if not grid.size:
        return None
    searched = math.log(len(CHANNELS) * grid.size * _STEP)
    records = {id(flow): _Record(few, grid) for flow, few in zip(long_enough, rare, strict=True)}
    found = [swing for c in CHANNELS if (swing := _of_channel(kinds_of(long_enough, c), records, c, grid, searched)) is not None]
    return max(found, key=lambda swing: swing.log_evidence, default=None)


def _of_channel(kinds: Sequence[Kind], records: Mapping[int, _Record], channel: str, grid: FloatArray, searched: float) -> Swing | None:
    members = [records[id(flow)] for kind in kinds for flow in kind.flows]
    if len(members) < _FEWEST:
        return None
    asked = grid[:, None] * (1.0 + np.arange(_HARMONICS))
    floors = floors_of(kinds, asked.ravel()).reshape(len(members), *asked.shape)
    if not np.all(floors > 0.0):
        return None
    heard = [record.heard(channel, floor) for record, floor in zip(members, floors, strict=True)]
    of_all = _Told(np.stack([h.score for h in heard], axis=1), np.stack([h.information for h in heard], axis=1))
    best = int(np.argmax(of_all.common() / np.maximum(of_all.each().sum(axis=1), 1e-300)))
    # one record that was disturbed is as much of it wherever it is moved
    beyond = _evidence(_Told(of_all.score[best], of_all.information[best])) - searched
    return Swing(channel, float(grid[best]), beyond, len(members)) if beyond > _MARGIN else None


def _evidence(told: _Told) -> float:
    """Minus the log of the chance that records which have nothing in common share so much.

    Common power over all power is a beta of half as many degrees as either has; how many that are the moved records tell.
    """
    whole = max(float(told.each().sum()), 1e-300)
    # the same moves at every call: what is said of a campaign does not change from one to the next
    rng = np.random.default_rng(len(told.score))
    chance = told.moved(rng.random((_MOVES, len(told.score)))).common() / whole
    share, mean, variance = float(told.common()) / whole, float(chance.mean()), float(chance.var())
    if share <= mean or variance == 0.0:
        return 0.0
    size = mean * (1.0 - mean) / variance - 1.0
    return -_log_upper_tail(share, mean * size, (1.0 - mean) * size)


def _log_upper_tail(x: float, a: float, b: float) -> float:
    """Log of the chance of a beta variable to be larger than x, however small it is."""
    rest = 1.0 - min(x, 1.0 - 1e-12)
    tail = float(betainc(b, a, rest))
    if tail > _LEAST_CHANCE:
        return math.log(tail)
    return float(a * math.log1p(-rest) + b * math.log(rest) - math.log(b) - betaln(a, b) + math.log(hyp2f1(a + b, 1.0, b + 1.0, rest)))


class _Record:
    """What one record tells of waveforms of every period, beside what else moves in it.

    Parameters
    ----------
    flow : FlowLeft
    grid : ndarray, shape (periods,)
        Of their first harmonics [Hz].
    """

    def __init__(self, flow: FlowLeft, grid: FloatArray) -> None:
        self._row_s = flow.row_s
        self._window = np.hanning(len(flow.azimuth_rad) + 2)[1:-1]
        aside = besides(flow, self._window)
        t = flow.start_s + flow.row_s * np.arange(len(self._window))
        first = np.exp(2j * np.pi * grid[:, None] * t)
        harmonics = np.stack([first ** (k + 1) for k in range(_HARMONICS)], axis=1)
        # cos and sin of every harmonic, shape (periods, k, rows)
        waves = np.stack([harmonics.real, harmonics.imag], axis=2).reshape(grid.size, 2 * _HARMONICS, -1)
        heard = waves * self._window
        beside = heard @ aside
        self._gram = heard @ waves.swapaxes(1, 2) - beside @ beside.swapaxes(1, 2)
        self._sums = {c: heard @ (x - aside @ (aside.T @ (self._window * x))) for c, x in flow.rate.items()}
        size, axes = np.linalg.eigh(self._gram)
        inverse = np.where(size > _ALIKE * size[:, -1:], 1.0 / np.maximum(size, 1e-300), 0.0)
        self._inverse = (axes * inverse[:, None]) @ axes.swapaxes(1, 2)

    def heard(self, channel: str, floor: FloatArray) -> _Told:
        """Of a channel at every period, in the records' place; ``floor``: density, shape (periods, harmonics)."""
        window = self._window
        # noise of density S(f) is heard with the window's square; between two harmonics it is the mean of what both have
        noise = np.sqrt(np.repeat(floor, 2, axis=1) * float(np.sum(window**2) / window.sum()) / self._row_s)
        # what is heard is gram times the sizes, and noise of covariance noise gram noise
        towards = (self._gram / noise[:, None]) @ self._inverse
        score = np.squeeze(towards @ (self._sums[channel] / noise)[..., None], axis=2)
        return _Told(score, towards @ (self._gram / noise[:, :, None]))


def _power(score: FloatArray, information: FloatArray) -> FloatArray:
    """``score^T information^-1 score`` of each, in the directions that it tells."""
    size, axes = np.linalg.eigh(information)
    along = np.squeeze(score[..., None, :] @ axes, axis=-2)
    return np.asarray(np.sum(np.where(size > _ALIKE * size[..., -1:], along**2 / np.maximum(size, 1e-300), 0.0), axis=-1))


def _rarely(flow: FlowLeft, row_s: float) -> FlowLeft:
    """The record with means of so many rows that one of them takes about ``row_s``."""
    rows = max(int(row_s / flow.row_s), 1)
    kept = len(flow.azimuth_rad) // rows * rows

    def means(x: FloatArray) -> FloatArray:
        return np.asarray(x[:kept].reshape(-1, rows).mean(axis=1))

    return replace(
        flow,
        row_s=flow.row_s * rows,
        rate={name: means(x) for name, x in flow.rate.items()},
        azimuth_rad=means(flow.azimuth_rad),
        start_s=flow.start_s + 0.5 * (rows - 1) * flow.row_s,
    )
