"""One entry for every method: look at what the campaign holds and estimate."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import CalibrationRefused
from ..recording.recording import Campaign
from .document_method import calibrate_document
from .result import CalibrationResult
from .sideband import calibrate_sideband
from .whole_angle import calibrate_whole_angle

__all__ = ["METHODS", "calibrate"]

#: method -> (operating modes that it needs, estimator); the first that fits is taken, so the one of more modes comes first where both fit:
#: a whole-angle campaign may hold force-to-rebalance stretches too, and uses them
METHODS: dict[str, tuple[tuple[str, ...], Callable[..., CalibrationResult]]] = {
    "virtual_precession": (("whole_angle",), calibrate_whole_angle),
    "sideband": (("ftr_x", "ftr_y"), calibrate_sideband),
    "document": (("ftr_x", "ftr_y"), calibrate_document),
}


def calibrate(
    campaign: Campaign, *, method: str = "auto", on_progress: Callable[[float], None] | None = None, with_convergence: bool = True
) -> CalibrationResult:
    """Estimate bias, scale factor and parameters of a device from its recordings.

    Parameters
    ----------
    campaign : Campaign
        Recordings of one device.
    method : str
        ``"auto"`` (by the modes present) or one of :data:`METHODS`.
    on_progress : callable, optional
        Called with a fraction 0-1.
    with_convergence : bool
        Also estimate from growing subsets of the recordings.

    Raises
    ------
    CalibrationRefused
        Unknown method, or recordings that no method can use.
    """
    modes = {r.command.mode for r in campaign}
    if method == "auto":
        fitting = [name for name, (needed, _) in METHODS.items() if set(needed) <= modes]
        if not fitting:
            known = "; ".join(name + ": " + ", ".join(needed) for name, (needed, _) in METHODS.items())
            raise CalibrationRefused(
                f"Campaign must hold the modes of one method ({known}), but got {', '.join(sorted(modes)) or 'no recordings'}."
            )
        method = fitting[0]
    if method not in METHODS:
        raise CalibrationRefused(f"Method must be one of auto, {', '.join(METHODS)}, but got {method!r}.")
    return METHODS[method][1](campaign, on_progress=on_progress, with_convergence=with_convergence)
