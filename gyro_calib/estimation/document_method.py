"""Document 000's estimator as a method of :func:`.calibrate`: its 15 (23 with E) parameters by Eq. 19, then the same physical step.

The product estimator (:mod:`.sideband`) uses the same recordings and is preferred: it also weighs carrier lines and nonlinear terms.
This one is there to be compared with, and for whoever wants the document to the letter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ..errors import CalibrationRefused
from ..recording.recording import Campaign
from .document_fit import document_fit, rough_start
from .result import CalibrationResult
from .separation import Priors
from .sideband import SidebandProblem
from .slow_flow_data import usable_recordings

__all__ = ["calibrate_document"]


def calibrate_document(
    campaign: Campaign,
    *,
    cost: str = "positions",
    priors: Priors | None = None,
    on_progress: Callable[[float], None] | None = None,
    with_convergence: bool = True,
) -> CalibrationResult:
    """Estimate rate, bias and scale factor by the document's own fit (Eq. 19).

    Parameters
    ----------
    campaign : Campaign
        Side bands on both oscillator axes; open drive and body excitation as there are.
    cost : {"positions", "transfer_functions"}
        What Eq. 19 compares; with positions the carriers of the closed axis are compared too (most of what is known of a constant rate).
    priors : Priors, optional
        What is known of the pick-off chain.
    on_progress : callable, optional
        Called with a fraction 0-1.
    with_convergence : bool
        Accepted for the common signature; the document's fit is done once.

    Raises
    ------
    CalibrationRefused
        The recordings or the factory data do not support the estimate, or the fit did not converge.
    """
    kappa = campaign.factory.get("angular_gain_kappa")
    if not isinstance(kappa, int | float) or not kappa > 0:
        raise CalibrationRefused(f"Factory data must hold a positive angular_gain_kappa, but got {kappa!r}. Take it from the factory.")
    recordings, skipped = usable_recordings(campaign)
    if not recordings:
        raise CalibrationRefused("Campaign must hold force-rebalance recordings (ftr_x and ftr_y), but got none.")
    start = partial(rough_start, factory=campaign.factory)
    found = document_fit(recordings, start, cost=cost, with_carrier=cost == "positions")
    if not found.converged:
        raise CalibrationRefused("Fit of document 000 must converge, but did not. Use the method sideband, or record more side bands.")
    if on_progress is not None:
        on_progress(0.8)
    problem = SidebandProblem(recordings, campaign.factory, float(kappa), priors or Priors(), fit=found.slow_flow())
    values, covariance = problem.solve()
    result = problem.result(campaign.device_id, values, covariance, tuple(skipped), ())
    if on_progress is not None:
        on_progress(1.0)
    return replace(result, method="document" if cost == "positions" else f"document/{cost}")
