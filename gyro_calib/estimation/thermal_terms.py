"""What moves with temperature inside a campaign: known columns with unknown, bounded coefficients, beside the slow flow at one temperature.

With ``A(T) = A + (T - T0) A'`` and ``G(T) = G + (T - T0) G'`` the slow flow stays linear in everything unknown. The resonance itself is
followed by the recordings; what is left of ``A'`` is the cross stiffness (document 000's reciprocity compares K_yx, measured while x
oscillates, with K_xy, measured while y does: half a drift of 135 ppm between the two passes for 34 ppm of r), the damping and the cross
damping; of ``G'`` its diagonal, the gains, of which the factory's ratio is compared. A coefficient that the recordings tell is found; one
that they do not keeps its prior and widens what depends on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .linear_fit import Equation
from .projection import Projected

__all__ = ["THERMAL_TERMS", "ThermalTerms"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: columns per axis: slope of A to the other axis, of A to its own, of G to its own
THERMAL_TERMS = 3
#: relative slope of damping: Q ~ T^-n with n up to 3 (thermoelastic damping) at room temperature [1/K]
_DAMPING_PER_K = 0.01
#: relative slope of a gain, and of its phase [1/K], [rad/K]: capacitors, references and amplifiers
_GAIN_PER_K = 3e-4
#: a cross stiffness of another origin than the material's modulus may move by so many times the modulus (fixed split in hertz: half)
_STIFFNESS_FACTOR = 2.0
#: least standard deviation of a slope [1/(s K)], far below what matters: 1e-4 deg/h per kelvin
_LEAST = 1e-9


@dataclass(frozen=True)
class ThermalTerms:
    """Priors of the slopes, from the size of what moves.

    Parameters
    ----------
    sd_re, sd_im : ndarray, shape (2, THERMAL_TERMS)
        Standard deviations of real and imaginary part of each axis' slopes [1/(s K)].
    """

    sd_re: FloatArray
    sd_im: FloatArray

    @classmethod
    def of(cls, A: ComplexArray, G: ComplexArray, stiffness_per_k: float) -> ThermalTerms:
        """From a rough slow flow, shapes (2, 2), and the relative slope of the stiffness [1/K].

        Damping and its anisotropy may move apart (anchors beside thermoelastic damping): the size is that of the anisotropy whichever its
        azimuth. The stiffness of one material moves as one.
        """
        anisotropy = abs(complex(0.5 * (A[0, 0] - A[1, 1]).real, 0.5 * (A[0, 1] + A[1, 0]).real))
        stiffness = _STIFFNESS_FACTOR * abs(stiffness_per_k) * 0.5 * (abs(A[0, 1].imag) + abs(A[1, 0].imag))
        damping = 0.5 * abs((A[0, 0] + A[1, 1]).real)
        sd_re, sd_im = np.empty((2, THERMAL_TERMS)), np.empty((2, THERMAL_TERMS))
        for axis in range(2):
            gain = _GAIN_PER_K * abs(G[axis, axis])
            sd_re[axis] = _DAMPING_PER_K * anisotropy, _DAMPING_PER_K * damping, gain
            # the resonance of an axis moves with the split at most: the rest is followed by the recordings
            sd_im[axis] = stiffness, stiffness, gain
        return cls(np.maximum(sd_re, _LEAST), np.maximum(sd_im, _LEAST))

    def columns(self, projected: Projected, axis: int) -> ComplexArray:
        """Regressors of one recording for one axis, shape (m, THERMAL_TERMS)."""
        return np.column_stack([projected.warm_pick[:, 1 - axis], projected.warm_pick[:, axis], projected.warm_drive[:, axis]])

    def prior(self, axis: int, coefficients: int) -> Equation:
        """The priors as equations of ``coefficients`` complex unknowns, of which the slopes are the last."""
        regressors = np.zeros((THERMAL_TERMS, coefficients), dtype=complex)
        regressors[:, -THERMAL_TERMS:] = np.eye(THERMAL_TERMS)
        blank = np.zeros(THERMAL_TERMS, dtype=complex)
        return Equation(blank, regressors, np.eye(THERMAL_TERMS), self.sd_re[axis], self.sd_im[axis])
