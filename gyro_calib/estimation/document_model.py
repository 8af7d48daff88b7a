"""The model of document 000: 15 parameters (23 with feed-forward) and the positions that they and the measured drives predict.

Position H(nu) u at omega + nu, with the sensor's own transfer function, not its first order of averaging (theory.md Eq. 4 is the limit
nu << omega). Per unit modal mass, in pick-off volts, with ``s = i (omega + nu)``, ``omega0`` a fixed frequency near resonance:

    M(nu) p = G u,     M_aa = i m_a + i nu (omega/omega0 + nu/(2 omega0)) + (b_a/2) f,    f = (omega + nu)/omega0,
                       M_xy = (b_xy/2) f - i k_xy/(2 omega0),   G = B/(2 i omega0),       V = p + E u.

``m_a = (omega^2 - omega_a^2)/(2 omega0)`` is how far the reference is from the resonance of axis a. It is no parameter (document 000:
"terms of the form m s^2 + b s + k should be avoided"): an oscillator sits where its drive is pi/2 from its position, so the carrier of the
same recording gives ``m_a = Im[(G_a u - M_ac p_c) e^{i alpha} / p_a]`` with ``alpha`` the oscillator's phase deviation, the last of the 15.
The closed axis needs it only times its own nulled position: it is taken from the recordings on which that axis was the oscillator.

A cubic stiffness makes the resonance follow the amplitude, ``A_aa + i d_a |p_a|^2`` (document 000, Eqs. 20, 21, 25-27). The document holds
that side-band demodulation removes it, since the PLL follows. It does not, for the forcers' phases: on a reference that follows, they
leave no trace in an amplitude modulation, and they carry the quadrature into the rate. They show on the smooth reference used here, where
``d_a`` shows too. With ``stiffening`` the two ``d_a`` are parameters; the first side bands of ``|p|^2 p`` about the carrier are
``|p_0|^2 p(nu) + p_0^2 p*(-nu)`` beyond what the carrier's own detuning holds (theory.md section 4 has them by quadrature).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from .document_rows import ResonanceTrack, Rows, line_amplitudes
from .sideband_table import SidebandRow

__all__ = ["FEEDFORWARD", "FIRST_FIFTEEN", "STIFFENING", "DocumentModel"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: the 15 parameters of the estimator (document 000, Table 1, whose rows are lost: theory.md section 4). B: volts of pick-off per s^2 and
#: volt of drive; b, k per unit mass, cross terms as each axis sees them: A_xy = -b_xy/2 + i k_xy/(2 omega0)
FIRST_FIFTEEN: tuple[str, ...] = (
    *(f"B_{row}{column}_{part}" for row in "xy" for column in "xy" for part in ("re", "im")),
    "b_x", "b_y", "b_xy", "b_yx", "k_xy", "k_yx", "oscillator_phase",
)  # fmt: skip
#: the complex feed-forward, measured off resonance
FEEDFORWARD: tuple[str, ...] = tuple(f"E_{row}{column}_{part}" for row in "xy" for column in "xy" for part in ("re", "im"))
#: how the resonances follow the square of the amplitude
STIFFENING: tuple[str, ...] = ("stiffening_x", "stiffening_y")
_B_X, _B_XY, _K_XY, _ALPHA, _E = 8, 10, 12, 14, 15
#: row and column of the four elements in their order
_ROW, _COLUMN = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])


class DocumentModel:
    """Positions of the table's rows as functions of the parameters.

    Parameters
    ----------
    table : list of SidebandRow
        Loop recordings on both oscillator axes; loops-off ones with ``drive`` or ``body`` excitation as there are.
    fit_feedforward : bool
        E is among the parameters (needs open drive off resonance); otherwise it is ``feedforward``.
    feedforward : ndarray, shape (2, 2), complex, optional
        E when it is not fitted (default zero).
    stiffening : bool
        The resonances follow the amplitude: two parameters more.

    Attributes
    ----------
    names : tuple of str
        Parameters in order: the 15, then E, then the response to body excitation (volts of pick-off per s and volt), then the stiffening
        (rad/s per V^2).
    """

    def __init__(
        self, table: list[SidebandRow], *, fit_feedforward: bool, feedforward: ComplexArray | None = None, stiffening: bool = False
    ) -> None:
        self.table = table
        self.loops = [r for r in table if r.axis]
        for axis in "xy":
            if not any(r.axis == axis for r in self.loops):
                raise CalibrationRefused(
                    f"Recordings must include {axis} as the oscillator, but got none. Record the same side bands with the axes swapped."
                )
        self.omega0 = float(np.mean([r.omega_rad_s for r in self.loops]))
        self.middle_s = float(np.mean([r.time_s for r in self.loops]))
        self.bodies = sorted({r.omega_rad_s for r in table if r.kind == "body"})
        self.fit_feedforward = fit_feedforward
        self.feedforward = np.zeros((2, 2), dtype=complex) if feedforward is None else np.asarray(feedforward, dtype=complex)
        extra = tuple(f"body_{i}_{a}_{part}" for i in range(len(self.bodies)) for a in "xy" for part in ("re", "im"))
        self.stiffening = stiffening
        self.names = FIRST_FIFTEEN + (FEEDFORWARD if fit_feedforward else ()) + extra + (STIFFENING if stiffening else ())
        self._osc = np.array(["xy".index(r.axis) for r in self.loops])
        self._track = ResonanceTrack(self.loops, self._osc, self.omega0)
        self._level = np.array([np.mean([abs(r.carrier_pick["xy".index(a)]) for r in self.loops if r.axis == a]) for a in "xy"])
        self._p0 = np.array([r.carrier_pick for r in self.loops])
        self._recorded0 = np.array([r.carrier_drive for r in self.loops])
        self._acting0 = self._recorded0 * np.array([r.hold(np.zeros(1), self.omega0) for r in self.loops])

    def drive_per_pickoff(self, axis: str) -> float:
        """Volts of drive per volt of pick-off at the carrier of an oscillator axis."""
        own = [k for k, r in enumerate(self.loops) if r.axis == axis]
        place = "xy".index(axis)
        return float(np.mean(np.abs(self._recorded0[own, place] / self._p0[own, place])))

    def matrices(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """G, E, body response (2, bodies) of a parameter vector."""
        G = theta[:_B_X].view(np.complex128).reshape(2, 2) / (2j * self.omega0)
        at = _E
        E = self.feedforward
        if self.fit_feedforward:
            E = theta[at : at + 8].view(np.complex128).reshape(2, 2)
            at += 8
        return G, E, theta[at : at + 4 * len(self.bodies)].view(np.complex128).reshape(-1, 2).T

    def _force(self, theta: FloatArray, rows: Rows) -> ComplexArray:
        """Everything that moves the resonator, (n, 2) [V/s]."""
        G, _, body = self.matrices(theta)
        force = rows.acting @ G.T + rows.body @ body.T
        return force + 1j * rows.cube * theta[-2:] if self.stiffening else force

    def resonances(self, theta: FloatArray) -> FloatArray:
        """Imaginary parts of A's diagonal, (omega_a^2 - omega0^2)/(2 omega0) of x and y, in the middle of the loop recordings [rad/s]."""
        m, _ = self._detunings(np.ascontiguousarray(theta))
        offset, link = self._track.at(self.middle_s)
        return -(offset + link @ m)

    def resonance_scatter(self, theta: FloatArray) -> tuple[float, FloatArray]:
        """How far single recordings are off the track of the resonances [rad/s]; square times matrix (2, 2): covariance of the level."""
        m, _ = self._detunings(np.ascontiguousarray(theta))
        _, weights = self._track.at(self.middle_s)
        return self._track.scatter(m), weights @ weights.T

    def flow(self, theta: FloatArray) -> ComplexArray:
        """A of theory.md Eq. 3 about omega0, in the middle of the loop recordings, shape (2, 2) [1/s]."""
        diagonal = -0.5 * theta[_B_X : _B_X + 2] + 1j * self.resonances(theta)
        cross = -0.5 * theta[_B_XY : _B_XY + 2] + 0.5j * theta[_K_XY : _K_XY + 2] / self.omega0
        return np.array([[diagonal[0], cross[0]], [cross[1], diagonal[1]]])

    def flow_of(self, theta: FloatArray, loop: int) -> tuple[ComplexArray, ComplexArray]:
        """Factors of p and p' in one loop recording: ``-M(0)`` [1/s] and the factor of ``i nu`` in ``M(nu)``, each (2, 2)."""
        row = self.loops[loop]
        m, _ = self._detunings(np.ascontiguousarray(theta))
        offset, link = self._detuning_of(row)
        damping = -0.5 * np.array([[theta[_B_X], theta[_B_XY]], [theta[_B_XY + 1], theta[_B_X + 1]]])
        A: ComplexArray = np.asarray(damping * (row.omega_rad_s / self.omega0), dtype=np.complex128)
        A[[0, 1], [1, 0]] += 0.5j * theta[_K_XY : _K_XY + 2] / self.omega0
        A[[0, 1], [0, 1]] -= 1j * (offset + link @ m)
        return np.asarray(A), np.asarray(row.omega_rad_s / self.omega0 * np.eye(2) + 1j * damping / self.omega0)

    def rows(self, chosen: list[SidebandRow], lines: list[FloatArray]) -> Rows:
        """Rows of each recording at its signed frequencies: 0 the carrier, +-nu its side band, anything else one of its quiet lines."""
        count = sum(nus.size for nus in lines)
        nu, stretch, damping = np.empty(count), np.empty(count), np.empty(count)
        offset, link = np.empty((count, 2)), np.empty((count, 2, len(self.loops)))
        acting, recorded, pick = (np.empty((count, 2), dtype=complex) for _ in range(3))
        body, cube = np.zeros((count, len(self.bodies))), np.zeros((count, 2), dtype=complex)
        first = 0
        for r, nus in zip(chosen, lines, strict=True):
            own = slice(first, first + nus.size)
            first += nus.size
            offset[own], link[own] = self._detuning_of(r)
            nu[own], stretch[own] = nus, nus * (r.omega_rad_s + 0.5 * nus) / self.omega0
            damping[own] = (r.omega_rad_s + nus) / self.omega0
            pick[own], recorded[own] = line_amplitudes(r, nus)
            acting[own] = recorded[own] * r.hold(nus, self.omega0)[:, None]
            if r.kind == "body":
                body[own, self.bodies.index(r.omega_rad_s)] = r.body_v * (nus == 0.0)
            if r.axis:
                axis = "xy".index(r.axis)
                opposite, _ = line_amplitudes(r, -nus)
                level = r.carrier_pick[axis]
                cube[own, axis] = (nus != 0.0) * (abs(level) ** 2 * pick[own, axis] + level**2 * opposite[:, axis].conj())
            else:
                # the track of the resonances was recorded at the oscillators' amplitude
                cube[own] = (np.abs(r.carrier_pick) ** 2 - self._level**2) * pick[own]
        return Rows(nu, stretch, damping, offset, link, acting, recorded, pick, body, cube)

    def dynamics(self, theta: FloatArray, rows: Rows) -> ComplexArray:
        """M of every row, shape (n, 2, 2)."""
        m, _ = self._detunings(np.ascontiguousarray(theta))
        return self._dynamics(theta, rows, m)

    def positions(self, theta: FloatArray, rows: Rows) -> ComplexArray:
        """Estimated pick-offs without feed-forward, (n, 2) [V]."""
        theta = np.ascontiguousarray(theta)
        return np.asarray(np.einsum("nab,nb->na", _inverse(self.dynamics(theta, rows)), self._force(theta, rows)))

    def equation_error(self, theta: FloatArray, rows: Rows) -> ComplexArray:
        """``M p - G u`` of the measured pick-offs, (n, 2) [V/s]: what forces on the resonator would have to explain."""
        theta = np.ascontiguousarray(theta)
        _, E, _ = self.matrices(theta)
        p = rows.pick - rows.recorded @ E.T
        return np.asarray(np.einsum("nab,nb->na", self.dynamics(theta, rows), p) - self._force(theta, rows))

    def error(self, theta: FloatArray, rows: Rows) -> tuple[ComplexArray, ComplexArray]:
        """Measured minus estimated pick-offs, (n, 2) [V], and their derivative by the parameters, (n, 2, p), as complex numbers."""
        theta = np.ascontiguousarray(theta)
        _, E, _ = self.matrices(theta)
        m, m_slope = self._detunings(theta)
        inverse = _inverse(self._dynamics(theta, rows, m))
        p = np.einsum("nab,nb->na", inverse, self._force(theta, rows))
        error = rows.pick - p - rows.recorded @ E.T
        # force per unit change of each parameter: (n, 2, p); d p = M^-1 (force)
        force = np.zeros((rows.nu.size, 2, theta.size), dtype=complex)
        slot = np.arange(4)
        force[:, _ROW, 2 * slot] = rows.acting[:, _COLUMN] / (2j * self.omega0)
        force[:, _ROW, 2 * slot + 1] = rows.acting[:, _COLUMN] / (2.0 * self.omega0)
        half = 0.5 * rows.damping[:, None] * p
        for a in range(2):
            force[:, a, _B_X + a] = -half[:, a]
            force[:, a, _B_XY + a] = -half[:, 1 - a]
            force[:, a, _K_XY + a] = 0.5j * p[:, 1 - a] / self.omega0
        start = _E + 8 * int(self.fit_feedforward)
        for i in range(rows.body.shape[1]):
            for a in range(2):
                force[:, a, start + 4 * i + 2 * a] = rows.body[:, i]
                force[:, a, start + 4 * i + 2 * a + 1] = 1j * rows.body[:, i]
        if self.stiffening:
            for a in range(2):
                force[:, a, theta.size - 2 + a] = 1j * rows.cube[:, a]
        force -= 1j * p[:, :, None] * (rows.link @ m_slope)
        slope = -(inverse @ force)
        if self.fit_feedforward:
            slope[:, _ROW, _E + 2 * slot] -= rows.recorded[:, _COLUMN]
            slope[:, _ROW, _E + 2 * slot + 1] -= 1j * rows.recorded[:, _COLUMN]
        return error, slope

    def _dynamics(self, theta: FloatArray, rows: Rows, m: FloatArray) -> ComplexArray:
        M = np.empty((rows.nu.size, 2, 2), dtype=complex)
        detuning = rows.offset + rows.link @ m + rows.stretch[:, None]
        for a in range(2):
            M[:, a, a] = 1j * detuning[:, a] + 0.5 * theta[_B_X + a] * rows.damping
            M[:, a, 1 - a] = 0.5 * theta[_B_XY + a] * rows.damping - 0.5j * theta[_K_XY + a] / self.omega0
        return M

    def _detunings(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """m of the oscillator of every loop recording, (loops,), from its carrier, and its derivative, (loops, p)."""
        G, E, _ = self.matrices(theta)
        index = np.arange(self._osc.size)
        osc, closed = self._osc, 1 - self._osc
        p = self._p0 - self._recorded0 @ E.T
        cross = 0.5 * theta[_B_XY + osc] - 0.5j * theta[_K_XY + osc] / self.omega0
        turn = np.exp(1j * theta[_ALPHA]) / p[index, osc]
        ratio = (np.einsum("kj,kj->k", G[osc], self._acting0) - cross * p[index, closed]) * turn
        slope = np.zeros((osc.size, theta.size), dtype=complex)
        for j in range(2):
            element = 2 * osc + j
            by_force = self._acting0[:, j] * turn / (2j * self.omega0)
            slope[index, 2 * element], slope[index, 2 * element + 1] = by_force, 1j * by_force
            if self.fit_feedforward:
                own = ratio * self._recorded0[:, j] / p[index, osc]
                other = cross * self._recorded0[:, j] * turn
                for target, value in ((osc, own), (closed, other)):
                    column = _E + 2 * (2 * target + j)
                    slope[index, column], slope[index, column + 1] = value, 1j * value
        by_cross = -p[index, closed] * turn
        slope[index, _B_XY + osc] = 0.5 * by_cross
        slope[index, _K_XY + osc] = -0.5j * by_cross / self.omega0
        slope[:, _ALPHA] = 1j * ratio
        return ratio.imag, slope.imag

    def _detuning_of(self, row: SidebandRow) -> tuple[FloatArray, FloatArray]:
        """Offset (2,) and link (2, loops) of m in one recording."""
        distance = (row.omega_rad_s**2 - self.omega0**2) / (2.0 * self.omega0)
        offset, link = self._track.at(row.time_s)
        offset = distance + offset
        for k, loop in enumerate(self.loops):
            if loop is row:
                axis = self._osc[k]
                offset[axis], link[axis] = 0.0, 0.0
                link[axis, k] = 1.0
        return offset, link


def _inverse(M: ComplexArray) -> ComplexArray:
    """Inverse of 2x2 matrices, shape (n, 2, 2)."""
    determinant = M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] * M[:, 1, 0]
    inverse = np.empty_like(M)
    inverse[:, 0, 0], inverse[:, 1, 1] = M[:, 1, 1], M[:, 0, 0]
    inverse[:, 0, 1], inverse[:, 1, 0] = -M[:, 0, 1], -M[:, 1, 0]
    return inverse / determinant[:, None, None]
