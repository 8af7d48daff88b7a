"""Separate the input rate from the cross damping: the pick-off frame, reciprocity, and what they cannot tell (theory.md Eq. 5, made exact).

With ``P = g diag(1, e^{i eps}) [[1, n - rho], [n + rho, r]]`` let ``M = P P^T`` without phases, ``M = [[m1, h], [h, m2]]``. D and K are
symmetric, so with ``A~ = A`` freed of eps (A~_yx = A_yx e^{-i eps}, A~_xy = A_xy e^{+i eps}):

* ``Im(A~) M`` is symmetric: K_yx m1 + K_yy h = K_xx h + K_xy m2 (Eq. 5's r^2 = K_yx/K_xy is the case h = 0);
* ``Re(A~) M`` has the antisymmetric part -kappa Omega sqrt(det M) J (Eq. 5's kappa Omega is the case h = 0).

theory.md takes the pick-offs as orthogonal. Where the frequency split has a part along the axes (K_xx != K_yy), a non-orthogonality n
of 1e-3 shifts Eq. 5's r by n (K_xx - K_yy)/K_xy, thousands of ppm, so h is an unknown here. Four sources give (r, h, eps): reciprocity
of the stiffness, the body excitation (eps; |r| up to twice the rotation rho), the factory's drive-gain ratio with |G_yy/G_xx|
(document 003's premise: constant while each gain drifts), and priors on n and rho.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .slow_flow_estimate import SlowFlowEstimate

__all__ = ["PickoffFrame", "Priors", "angular_response", "input_rate_times_kappa", "solve_pickoff_frame"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Priors:
    """What is known of a pick-off chain before any recording (engineering estimates, effects.md rows 13-15; not fitted to any device).

    Parameters
    ----------
    non_orthogonality_rad, rotation_rad : float
        Standard deviation of n, and of rho against the direction of the body excitation.
    mismatch, phase_rad : float
        Of r - 1 and of eps.
    drive_ratio : float
        How constant the factory's drive-gain ratio is held to be, relative.
    """

    non_orthogonality_rad: float = 5e-3
    rotation_rad: float = 5e-3
    mismatch: float = 0.05
    phase_rad: float = 0.02
    drive_ratio: float = 15e-6


@dataclass(frozen=True)
class PickoffFrame:
    """r, h and eps of the pick-offs.

    Parameters
    ----------
    ratio : float
        r = sqrt(m2/m1), y over x.
    skew : float
        h (m1 = 1), twice the non-orthogonality.
    phase_rad : float
        eps, y against x.
    prior_share : tuple of 3 float
        Share of each one's information that is prior (1: the data say nothing).
    rotation_rad : float
        rho, of the pick-offs against the direction of the body excitation; its prior's mean where there was none.
    """

    ratio: float
    skew: float
    phase_rad: float
    prior_share: tuple[float, float, float]
    rotation_rad: float = 0.0

    @property
    def metric(self) -> FloatArray:
        """M with m1 = 1, shape (2, 2)."""
        return np.array([[1.0, self.skew], [self.skew, self.ratio**2]])

    def without_phase(self, A: ComplexArray) -> ComplexArray:
        """A freed of eps."""
        turn = np.exp(1j * self.phase_rad)
        return np.asarray(A * np.array([[1.0, turn], [1.0 / turn, 1.0]]))


def input_rate_times_kappa(A: ComplexArray, frame: PickoffFrame) -> float:
    """kappa Omega from the antisymmetric part of ``Re(A~) M`` [rad/s]."""
    product = frame.without_phase(A).real @ frame.metric
    return float(-(product[1, 0] - product[0, 1]) / (2.0 * math.sqrt(np.linalg.det(frame.metric))))


def angular_response(frame: PickoffFrame, kappa: float) -> ComplexArray:
    """dA/dOmega = -kappa P J P^-1 = -kappa M J / sqrt(det M), with the phases put back; shape (2, 2)."""
    m = frame.metric
    bare = -kappa * m @ np.array([[0.0, -1.0], [1.0, 0.0]]) / math.sqrt(np.linalg.det(m))
    turn = np.exp(1j * frame.phase_rad)
    return np.asarray(bare * np.array([[1.0, 1.0 / turn], [turn, 1.0]]))


def solve_pickoff_frame(
    estimate: SlowFlowEstimate,
    vector: FloatArray,
    deviations: Deviations,
    drive_ratio_x_over_y: float | None,
    priors: Priors,
    nuisance: FloatArray,
    rate_response: ComplexArray | None = None,
) -> PickoffFrame:
    """Combine the sources for (r, h, eps) at one value of the parameter vector.

    Parameters
    ----------
    estimate : SlowFlowEstimate
        Layout of the vector.
    vector : ndarray, shape (n,)
        Real parameters.
    deviations : Deviations
        Weights of the sources (held fixed so that the solution is differentiable in ``vector``).
    drive_ratio_x_over_y : float or None
        Factory ratio.
    priors : Priors
        Widths of what the data may not tell.
    nuisance : ndarray, shape (5,)
        Means of the priors of n, rho, r, eps and of the drive-gain ratio, in their standard deviations (zero; moved to propagate them).
    rate_response : ndarray, shape (2, 2), complex, optional
        Measured dA/dOmega, where the gyro was turned: its form (not its size, which is kappa's) gives r, h and eps.
    """
    values = estimate.unpack(vector)
    A, G, body = values.A, values.G, values.body
    start = np.array([1.0, 0.0, 0.0, 0.0])
    if body.size:
        start[2] = float(np.angle(np.sum(body[1] * body[0].conj())))

    def residual(q: FloatArray) -> FloatArray:
        r, h, eps, rho = q
        frame = PickoffFrame(r, h, eps, (0.0, 0.0, 0.0))
        K = frame.without_phase(A).imag
        rows = [
            (K[1, 0] + K[1, 1] * h - K[0, 0] * h - K[0, 1] * r**2) / deviations.reciprocity,
            h / (2.0 * priors.non_orthogonality_rad) - nuisance[0],
            rho / priors.rotation_rad - nuisance[1],
            (r - 1.0) / priors.mismatch - nuisance[2],
            eps / priors.phase_rad - nuisance[3],
        ]
        n = 0.5 * h
        for k in range(body.shape[1]):
            ratio = body[1, k] / body[0, k] * np.exp(-1j * eps)
            rows += [(ratio.real - (r + n + rho) / (1.0 + n - rho)) / deviations.body[k], ratio.imag / deviations.body[k]]
        if drive_ratio_x_over_y is not None:
            shifted = drive_ratio_x_over_y * (1.0 + nuisance[4] * priors.drive_ratio)
            # B is proportional to P^-1 G: its diagonal, couplings and non-orthogonality taken out
            drive = np.linalg.solve(np.array([[1.0, n - rho], [n + rho, r]]), G * np.array([[1.0], [np.exp(-1j * eps)]]))
            rows.append((abs(drive[1, 1] / drive[0, 0]) * shifted - 1.0) / deviations.gain_ratio)
        if rate_response is not None and deviations.rate_response is not None:
            size = np.sqrt(np.linalg.det(rate_response))
            left = (rate_response / (size if size.real > 0.0 else -size) - angular_response(frame, 1.0)).ravel()
            rows += [*(left.real / deviations.rate_response[:, 0]), *(left.imag / deviations.rate_response[:, 1])]
        return np.array(rows)

    solution = least_squares(residual, start, x_scale=[1e-2, 1e-3, 1e-3, 1e-3], xtol=1e-15, ftol=1e-15, gtol=1e-15, method="lm")
    information = solution.jac.T @ solution.jac
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    widths = np.array([priors.mismatch, 2.0 * priors.non_orthogonality_rad, priors.phase_rad])
    share = np.minimum(1.0, (spread[:3] / widths) ** 2)
    r, h, eps, rho = solution.x
    return PickoffFrame(float(r), float(h), float(eps), (float(share[0]), float(share[1]), float(share[2])), float(rho))


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of the sources of (r, h, eps).

    Parameters
    ----------
    reciprocity : float
        Of the stiffness condition [1/s].
    body : tuple of float
        Of the body ratio at each body frequency, relative.
    gain_ratio : float
        Of |G_yy/G_xx| times the factory ratio, relative, its constancy included.
    rate_response : ndarray, shape (4, 2), or None
        Of real and imaginary part of each entry of dA/dOmega over its size.
    """

    reciprocity: float
    body: tuple[float, ...]
    gain_ratio: float
    rate_response: FloatArray | None = None

    @classmethod
    def of(cls, estimate: SlowFlowEstimate, priors: Priors) -> Deviations:
        """From the covariance of the fit."""
        sd = np.sqrt(np.diag(estimate.covariance))
        G, spread = estimate.values.G, estimate.unpack(sd)
        frequency = math.hypot(spread.A[1, 0].imag, spread.A[0, 1].imag)
        G_sd = spread.G
        gain = math.hypot(abs(G_sd[1, 1].imag / G[1, 1]), abs(G_sd[0, 0].imag / G[0, 0]))
        body_sd = np.abs(spread.body) / np.maximum(np.abs(estimate.values.body), 1e-300)
        body = tuple(max(float(math.hypot(*body_sd[:, k])) / math.sqrt(2.0), 1e-9) for k in range(body_sd.shape[1]))
        return cls(max(frequency, 1e-12), body, max(math.hypot(gain, priors.drive_ratio), 1e-9))
