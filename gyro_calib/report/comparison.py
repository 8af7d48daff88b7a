"""Before and after against the hidden truth of a simulated unit. Only demonstrations and tests know a truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

from ..quantity import Quantity
from ..units import DEG_H, PPM
from .table import Table, number, quantity_cells

__all__ = ["Comparison", "HasTruth", "compare", "comparison_table"]


class HasTruth(Protocol):
    """``rate_raw = scale_factor * rate + bias_rad_s``, as it truly is."""

    @property
    def bias_rad_s(self) -> float:
        """Bias [rad/s]."""
        ...

    @property
    def scale_factor(self) -> float:
        """Scale factor [1]."""
        ...


@dataclass(frozen=True)
class Comparison:
    """Errors of the rate, in deg/h and ppm.

    Parameters
    ----------
    before_bias, before_scale_factor : Quantity
        Of ``rate_raw``: true bias, and true scale factor minus 1 (sd 0: the truth has none).
    after_bias, after_scale_factor : Quantity
        Of the corrected rate: what the estimate leaves, with the sd of the estimate.
    error_bias, error_scale_factor, error_rate : Quantity
        Estimate minus truth, with the sd of the estimate.
    """

    before_bias: Quantity
    before_scale_factor: Quantity
    after_bias: Quantity
    after_scale_factor: Quantity
    error_bias: Quantity
    error_scale_factor: Quantity
    error_rate: Quantity

    def to_json(self) -> dict[str, Any]:
        """``{"before": {"bias", "scale_factor_error"}, "after": {…}, "error": {…, "rate"}}`` with quantities."""
        return {
            "before": {"bias": self.before_bias.to_json(), "scale_factor_error": self.before_scale_factor.to_json()},
            "after": {"bias": self.after_bias.to_json(), "scale_factor_error": self.after_scale_factor.to_json()},
            "error": {
                "bias": self.error_bias.to_json(),
                "scale_factor_error": self.error_scale_factor.to_json(),
                "rate": self.error_rate.to_json(),
            },
        }


def compare(
    truth: HasTruth, true_rate_rad_s: float, bias: Quantity, scale_factor: Quantity, rate: Quantity, *, before: HasTruth | None = None
) -> Comparison:
    """Compare an estimate with the truth.

    Parameters
    ----------
    truth : object with bias_rad_s, scale_factor
        True model of ``rate_raw``.
    true_rate_rad_s : float
        True constant input rate [rad/s].
    bias, scale_factor, rate : Quantity
        Estimates of ``rate_raw``'s bias [rad/s], scale factor [1] and of the input rate [rad/s].
    before : object with bias_rad_s, scale_factor, optional
        True model of ``rate_raw`` before the calibration, where that changed it too (drive compensation); default: ``truth``.

    Returns
    -------
    Comparison
        With ``b``, ``K`` true and ``b'``, ``K'`` estimated the corrected rate is ``(K w + b - b') / K'``: bias ``(b - b') / K'``, scale
        factor ``K / K'``.
    """
    estimated = scale_factor.value
    before = before or truth
    return Comparison(
        before_bias=Quantity(before.bias_rad_s / DEG_H, 0.0, "deg/h"),
        before_scale_factor=Quantity((before.scale_factor - 1.0) / PPM, 0.0, "ppm"),
        after_bias=Quantity((truth.bias_rad_s - bias.value) / estimated / DEG_H, bias.sd / abs(estimated) / DEG_H, "deg/h"),
        after_scale_factor=Quantity((truth.scale_factor / estimated - 1.0) / PPM, scale_factor.sd / abs(estimated) / PPM, "ppm"),
        error_bias=Quantity((bias.value - truth.bias_rad_s) / DEG_H, bias.sd / DEG_H, "deg/h"),
        error_scale_factor=Quantity((estimated - truth.scale_factor) / PPM, scale_factor.sd / PPM, "ppm"),
        error_rate=Quantity((rate.value - true_rate_rad_s) / DEG_H, rate.sd / DEG_H, "deg/h"),
    )


def comparison_table(comparison: Comparison) -> Table:
    """Before, after, claimed sd and how many times better."""
    rows = [
        _row("bias", comparison.before_bias, comparison.after_bias),
        _row("scale-factor error", comparison.before_scale_factor, comparison.after_scale_factor),
    ]
    header = ("", "before", "after", "claimed sd", "unit", "better by")
    caption = "Scale factor relative to the angular gain κ of the factory data."
    return Table("Before and after, against the hidden truth", header, tuple(rows), caption=caption)


def _row(name: str, before: Quantity, after: Quantity) -> tuple[str, ...]:
    value, sd, unit = quantity_cells(after)
    # an error far below its own sd says luck, not quality: compare with the larger of the two
    left_over = max(abs(after.value), after.sd)
    gain = abs(before.value) / left_over if left_over > 0.0 else math.inf
    return name, number(before.value, max(after.sd, 1.0)), value, sd, unit, f"{gain:,.0f}×".replace(",", "\u202f")
