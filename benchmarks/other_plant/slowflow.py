"""The slow flow of theory.md (Eq. 3) as a linear regression on windows of a recording: what is left is what the linear model lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaign import Recording
from kernel import Array

CArray = NDArray[np.complex128]
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass
class Table:
    """Equations, one pair per probe of a recording.

    Attributes
    ----------
    left : ndarray of complex, shape (n, 2)
        Probed change of the pick-off envelopes, turned by the reference's distance from resonance, without the table's Coriolis term.
    terms : dict of ndarray of complex, shape (n, 2)
        Probed envelopes that the linear model multiplies by constants.
    frame : ndarray, shape (n, 2, 2)
        Rows: unit vectors along and across the wave.
    record : ndarray of int, shape (n,)
        Which recording.
    sort : ndarray of str, shape (n,)
        Sort of probe: what has the same noise.
    """

    left: CArray
    terms: dict[str, CArray]
    frame: Array
    record: NDArray[np.int_]
    sort: NDArray[np.str_]


def _probes(rec: Recording, extra: float) -> list[tuple[float, float, float, str]]:
    """Begin, end, frequency and sort of the windows in which a recording is looked at."""
    t, step = rec.columns["t"], rec.step
    span = t[-1] - t[0]
    if step.mode == "loops_off":
        return [(t[0], t[-1], 0.0, "off")]
    if step.nu:
        length = max(int(np.floor(span * step.nu + 0.05)), 1) / step.nu
        return [(t[0], t[0] + length, k * step.nu, "line" if k else "whole") for k in (0, 1, -1, 2, -2)]
    bins = max(2, round(span / (0.8 if step.mode == "whole_angle" else 1.25)))
    kind = "moved" if step.ramp[1] or step.table else "turning" if step.precession else "bin"
    out = [(t[0] + span * i / bins, t[0] + span * (i + 1) / bins, 0.0, kind) for i in range(bins)]
    if extra and not step.ramp[1] and "hot" not in step.label:
        out.append((t[0], t[-1], extra, "tone"))
    return out


def tabulate(recordings: list[Recording], resonance_hz: float, kappa: float, extra: float = 0.0) -> Table:
    """Probe every recording: means over bins, lines of the side bands, and a line at an extra frequency if it is given."""
    names = ("p", "u", "du_closed", "du_open", "warm", "heating", "warm_u", "body")
    left, terms, frame, record, sort = [], {k: [] for k in names}, [], [], []  # type: ignore[var-annotated]
    for i, rec in enumerate(recordings):
        c, off = rec.columns, rec.step.mode == "loops_off"
        t = c["t"]
        p = np.stack([c["x_pick_c"] + 1j * c["x_pick_s"], c["y_pick_c"] + 1j * c["y_pick_s"]], 1)
        u = np.stack([c["x_drive_c"] + 1j * c["x_drive_s"], c["y_drive_c"] + 1j * c["y_drive_s"]], 1)
        # with these two the steady state of an open drive is exact at any distance from resonance
        delta = np.pi * (c["ref_freq"] - resonance_hz**2 / c["ref_freq"])[:, None]
        u = u * (resonance_hz / c["ref_freq"])[:, None]
        warm = (c["temperature"] - 25.0)[:, None]
        body = np.full_like(p, (rec.step.volts if rec.step.drive == "body" else 0.0) * resonance_hz / c["ref_freq"][0])
        coriolis = -kappa * (rec.rate - rec.rate[0])[:, None] * (p @ J.T)
        for start, stop, nu, kind in _probes(rec, extra):
            a, b = np.searchsorted(t, [start - 1e-9, stop - 1e-9])
            b = min(b, len(t) - 1)
            s, n, length = slice(a, b + 1), b - a, t[b] - t[a]
            w = np.exp(-2j * np.pi * nu * (t[s] - t[a]))[:, None]

            def mean(x: CArray, s: slice = s, w: CArray = w, n: int = n) -> CArray:
                y = x[s] * w
                return np.asarray((y.sum(0) - 0.5 * (y[0] + y[-1])) / n)

            def change(x: CArray, turn: Array, s: slice = s, w: CArray = w, length: float = length, nu: float = nu) -> CArray:
                y = x[s] * w
                return np.asarray((y[-1] - y[0]) / length + 2j * np.pi * nu * mean(x) + 1j * mean(turn * x))

            left.append(change(p, delta) - mean(coriolis))
            du = change(u, delta)
            mp = mean(p)
            values = {
                "p": mp,
                "u": mean(u),
                "du_closed": 0.0 * du if off else du,
                "du_open": du if off else 0.0 * du,
                "warm": mean(warm * p),
                "heating": mp * (warm[b, 0] - warm[a, 0]) / length,
                "warm_u": mean(warm * u),
                "body": mean(body),
            }
            for name in names:
                terms[name].append(values[name])
            n_vec = p[s].real.mean(0) if not off else np.array([1.0, 0.0])
            n_vec = n_vec / np.hypot(*n_vec)
            frame.append(np.array([n_vec, [-n_vec[1], n_vec[0]]]))
            record.append(i)
            sort.append(kind)
    return Table(np.array(left), {k: np.array(v) for k, v in terms.items()}, np.array(frame), np.array(record), np.array(sort))


def design(table: Table) -> CArray:
    """Columns of the healthy linear model, shape (n, 2, k): free 2x2 matrices, and isotropic temperature coefficients."""
    columns = []
    for name in ("p", "u", "du_closed", "du_open", "body"):
        for i in range(2):
            for j in range(2):
                column = np.zeros_like(table.left)
                column[:, i] = table.terms[name][:, j]
                columns.append(column)
    columns += [table.terms[name] for name in ("warm", "heating", "warm_u")]
    return np.stack([c for c in columns if np.any(c)], -1)


def real_form(table: Table, x: CArray) -> Array:
    """Turn rows into the frame of the wave and split them, (n, 2, ...) complex to (n, 4, ...) real.

    The four are amplitude, frequency, precession and quadrature.
    """
    y = np.einsum("nij,nj...->ni...", table.frame, x)
    return np.stack([y[:, 0].real, y[:, 0].imag, y[:, 1].real, y[:, 1].imag], 1)
