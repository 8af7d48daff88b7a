"""Trim check of the feedthrough (document 000, step 2): do the side bands agree with the E that the open drive gave?

E enters the loops-off records as ``i (omega - omega0) E u`` and the side bands as ``i nu E u``: other drives, other motion, another time. A
second E for the closed-loop records alone, ``E + dE``, adds to their equations (theory.md Eq. 3 with V = p + E u)

    L[V] - A V - G~ u - E L[u]  =  dE L[u] - A dE u  ~  dE (L[u] + u/tau),

so the residual of the transfer-function fit tells dE with its covariance. No dE: the feedthrough is as it was measured. A dE beyond chance:
it has moved since (or was never measured), or the drive chain has a delay that the recordings do not state, which to first order looks the
same: ``G e^{-i nu t_d}`` is dE = -t_d G.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from ..quantity import Quantity
from ..recording.recording import Recording
from .linear_fit import AXES, fit_axis
from .slow_flow_data import CampaignData, role_of
from .slow_flow_estimate import SlowFlowEstimate
from .slow_flow_fit import campaign_equations
from .thermal_terms import ThermalTerms

__all__ = ["FeedthroughCheck", "check_feedthrough"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: real numbers of dE
_UNKNOWNS = 8
#: a disagreement that chance makes less often than this is one
_CHANCE = 1e-3


@dataclass(frozen=True)
class FeedthroughCheck:
    """What the closed-loop records say of E.

    Parameters
    ----------
    measured : bool
        E came from open drive; otherwise from the side bands under a prior about zero.
    off_by : ndarray, shape (2, 2), complex
        dE: what the closed-loop records see beyond the E of the open drive, or beyond zero.
    sd : ndarray, shape (2, 2), complex
        Standard deviations of real and imaginary parts.
    chance : float
        How often chance alone would make a dE this large.
    """

    measured: bool
    off_by: ComplexArray
    sd: ComplexArray
    chance: float

    @property
    def consistent(self) -> bool:
        """Whether chance explains what was found."""
        return self.chance > _CHANCE

    @property
    def verdict(self) -> str:
        """The finding in a sentence, with the largest element and the remedy."""
        pulls = np.maximum(np.abs(self.off_by.real / self.sd.real), np.abs(self.off_by.imag / self.sd.imag))
        i, j = np.unravel_index(int(np.argmax(pulls)), (2, 2))
        d, s = 1e6 * self.off_by[i, j], 1e6 * self.sd[i, j]
        off = f"E_{AXES[i]}{AXES[j]} by {d.real:+.1f} ± {s.real:.1f} ppm in phase, {d.imag:+.1f} ± {s.imag:.1f} ppm at 90°"
        all_sd = 1e6 * self.sd.ravel().view(np.float64)
        known = f"chance {self.chance:.2g}; they know E to {np.median(all_sd):.2g} ppm (median), {all_sd.max():.2g} ppm (worst of 8)"
        if not self.measured:
            found = "not refuted by the side bands" if self.consistent else f"off, most {off}"
            return f"feedthrough was not measured; zero is {found} ({known}): run_feedthrough"
        if self.consistent:
            return f"feedthrough as measured is consistent with the side bands ({known})"
        return f"feedthrough as measured is off, most {off} ({known}): run_feedthrough again, or state the delay of the drives"

    def to_json(self) -> dict[str, Any]:
        """``{"measured", "consistent", "chance", "off_by": {"xx_re": …}}``."""
        off_by = {}
        for i, row in enumerate(AXES):
            for j, column in enumerate(AXES):
                d, s = self.off_by[i, j], self.sd[i, j]
                off_by[f"{row}{column}_re"] = Quantity(float(d.real), float(s.real), "1").to_json()
                off_by[f"{row}{column}_im"] = Quantity(float(d.imag), float(s.imag), "1").to_json()
        return {"measured": self.measured, "consistent": self.consistent, "chance": self.chance, "off_by": off_by}


def check_feedthrough(recordings: Sequence[Recording], fit: SlowFlowEstimate) -> FeedthroughCheck:
    """Find dE from the residuals of a fit.

    Parameters
    ----------
    recordings : sequence of Recording
        Those of the fit.
    fit : SlowFlowEstimate
        Its noise weighs; its values and everything else are free again.
    """
    if not fit.feedthrough_measured:
        return _without_open_drive(fit)
    decay = -0.5 * float(np.trace(fit.values.A).real)
    data = CampaignData.of(list(recordings), decay, with_quiet=False)
    thermal = None if data.stiffness_per_k is None else ThermalTerms.of(fit.values.A, fit.values.G, data.stiffness_per_k)
    shared = data.columns(data.signal, cubic=fit.has_cubic)
    off_by, sd = np.zeros((2, 2), dtype=complex), np.zeros((2, 2), dtype=complex)
    squares, chi2, dof = 0.0, 0.0, 0
    for axis in range(2):
        columns = []
        for common, p, r in zip(shared, data.signal, data.recordings, strict=True):
            trim = (p.drive_rate + decay * p.drive) * (r.command.oscillator_axis is not None)
            slopes = [] if thermal is None else [thermal.columns(p, axis)]
            columns.append(np.hstack([trim, common, *slopes]))
        roles = [role_of(r, axis, data.omega0) for r in data.recordings]
        models = {(role, part): fit.noise[AXES[axis], role, part] for role in set(roles) for part in ("re", "im")}
        known = [] if thermal is None else [thermal.prior(axis, columns[0].shape[1])]
        found = fit_axis(campaign_equations(data, columns, roles, axis, models) + known)
        off_by[axis] = found.coefficients[:2]
        block = found.covariance[:4, :4]
        sd[axis] = np.sqrt(np.diag(block)).view(np.complex128)
        step = np.ascontiguousarray(found.coefficients[:2]).view(np.float64)
        squares += float(step @ np.linalg.solve(block, step))
        chi2, dof = chi2 + found.chi2, dof + found.dof
    reduced = max(chi2 / max(dof, 1), 1.0)
    chance = float(fdtrc(_UNKNOWNS, max(dof, 1), squares / reduced / _UNKNOWNS))
    return FeedthroughCheck(True, off_by, np.asarray(math.sqrt(reduced) * sd, dtype=complex), chance)


def _without_open_drive(fit: SlowFlowEstimate) -> FeedthroughCheck:
    """What the side bands alone say of E: by its frequency they tell it from the drive gains, the diagonal hardly."""
    places = np.arange(fit.vector().size).reshape(2, -1)[:, 8:12].ravel()  # after A and G~, each two complex
    block = fit.covariance[np.ix_(places, places)]
    step = fit.vector()[places]
    chance = float(fdtrc(_UNKNOWNS, max(fit.dof, 1), float(step @ np.linalg.solve(block, step)) / _UNKNOWNS))
    sd = np.sqrt(np.diag(block)).view(np.complex128).reshape(2, 2)
    return FeedthroughCheck(False, fit.values.E, sd, chance)
