r"""What a calibrated rate is worth: its variance, in three readings.

With :math:`m = K\omega + b + n`, the calibrated rate :math:`\hat\omega = (m - \hat b)/\hat K` is wrong by

.. math:: \delta = \bigl(n - \delta b - \omega\,\delta K\bigr)/K,

a white part and one that stays the same from sample to sample. The white part has the variance :math:`\sigma_n^2 = S^2 B / K^2`, with
:math:`S` the one-sided noise density and :math:`B` the noise bandwidth, the constant part

.. math:: \sigma_c^2 = (\sigma_b^2 + \omega^2\sigma_K^2 + 2\,\omega\,\sigma_{bK})/K^2 .

``white``
    :math:`\sigma_n^2`. For a consumer that estimates the bias itself.
``total``
    :math:`\sigma_n^2 + \sigma_c^2`: the variance of one sample. For thresholds, display, or a filter with little memory. Integrated as if
    the samples were independent it claims too much: the constant part does not average out.
``horizon``
    For consumers that take every sample as independent (most filters): the variance whose integration is honest over a stated horizon
    :math:`T`. Independent errors of variance :math:`\sigma^2` at an interval :math:`\Delta t` give an angle variance
    :math:`\sigma^2\,\Delta t\,T` after :math:`T`; the truth is :math:`(S^2/2K^2)\,T + \sigma_c^2\,T^2`. Equal at :math:`T` for

    .. math:: \sigma^2 = \frac{S^2}{2 K^2 \Delta t} + \sigma_c^2\,\frac{T}{\Delta t}.

    Before :math:`T` the claimed angle variance is too large, after it too small.

The noise bandwidth defaults to half of the sample rate: then ``white`` is :math:`S^2/2K^2\Delta t`, right for integration whatever the
filter in the gyro. For one sample it is an upper bound where the noise is white up to a filter, and too small where it rises with
frequency, as that of a rebalance loop does: there measure the variance of samples at rest and set :math:`B` to it over :math:`S^2`
(the simulated ring at 100 Hz, whose density S holds below 1 Hz: some 3 kHz).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import DataError
from .record import CalibrationRecord

__all__ = ["COVARIANCE_MODES", "CovarianceModel", "RateErrorModel"]

COVARIANCE_MODES = ("white", "total", "horizon")


@dataclass(frozen=True)
class CovarianceModel:
    """Which variance is asked for.

    Parameters
    ----------
    mode : str
        One of :data:`COVARIANCE_MODES`; the module text derives them.
    sample_rate_hz : float
        Samples per second of the rate.
    bandwidth_hz : float or None
        Noise-equivalent bandwidth of the rate [Hz]; ``None`` for half of the sample rate.
    horizon_s : float
        T of mode ``horizon`` [s].

    Raises
    ------
    DataError
        Unknown mode, or a number that is not positive.
    """

    mode: str = "total"
    sample_rate_hz: float = 1000.0
    bandwidth_hz: float | None = None
    horizon_s: float = 60.0

    def __post_init__(self) -> None:
        if self.mode not in COVARIANCE_MODES:
            raise DataError(f"Covariance mode must be one of {', '.join(COVARIANCE_MODES)}, but got {self.mode!r}.")
        for name in ("sample_rate_hz", "bandwidth_hz", "horizon_s"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise DataError(f"Covariance {name} must be > 0, but got {value!r}.")

    @property
    def white_bandwidth_hz(self) -> float:
        """Bandwidth of the white part [Hz]; in mode ``horizon`` always half of the sample rate, as its derivation asks."""
        half = 0.5 * self.sample_rate_hz
        return half if self.bandwidth_hz is None or self.mode == "horizon" else self.bandwidth_hz

    @property
    def constant_weight(self) -> float:
        """Factor of the constant part: 0, 1 or T over the sample interval."""
        return {"white": 0.0, "total": 1.0, "horizon": self.horizon_s * self.sample_rate_hz}[self.mode]


@dataclass(frozen=True)
class RateErrorModel:
    """Bias, scale factor and noise of ``rate_raw`` with their uncertainty: all that applying a calibration needs.

    Parameters
    ----------
    bias_rad_s, bias_sd_rad_s : float
        b and its sd [rad/s].
    scale_factor, scale_factor_sd : float
        K and its sd, dimensionless.
    covariance_rad_s : float
        Covariance of b and K [rad/s].
    noise_density : float
        White noise of ``rate_raw``, one-sided [rad/s/sqrt(Hz)].
    """

    bias_rad_s: float
    bias_sd_rad_s: float
    scale_factor: float
    scale_factor_sd: float
    covariance_rad_s: float
    noise_density: float

    @classmethod
    def from_record(
        cls, record: CalibrationRecord, *, bias_drift_sd_rad_s: float = 0.0, scale_factor_drift_sd: float = 0.0, sd_factor: float = 1.0
    ) -> RateErrorModel:
        """Take it from a record.

        Parameters
        ----------
        record : CalibrationRecord
            What was found.
        bias_drift_sd_rad_s : float
            How far the bias moves between calibration and use, 1 sigma [rad/s]; no calibration knows that, its user may.
        scale_factor_drift_sd : float
            The same of the scale factor [1].
        sd_factor : float
            Factor on the sd of bias and scale factor, for a record outside its validity.
        """
        return cls(
            bias_rad_s=record.bias.value,
            bias_sd_rad_s=math.hypot(sd_factor * record.bias.sd, bias_drift_sd_rad_s),
            scale_factor=record.scale_factor.value,
            scale_factor_sd=math.hypot(sd_factor * record.scale_factor.sd, scale_factor_drift_sd),
            covariance_rad_s=sd_factor**2 * record.bias_scale_covariance,
            noise_density=record.rate_noise_density.value,
        )

    @classmethod
    def uncalibrated(cls, bias_sd_rad_s: float, scale_factor_sd: float, noise_density: float) -> RateErrorModel:
        """A gyro as it left the factory: bias 0 and scale factor 1, with what its data sheet says of them.

        Parameters
        ----------
        bias_sd_rad_s : float
            Standard deviation of the bias [rad/s].
        scale_factor_sd : float
            Of the scale factor [1].
        noise_density : float
            White noise, one-sided [rad/s/sqrt(Hz)].
        """
        return cls(0.0, bias_sd_rad_s, 1.0, scale_factor_sd, 0.0, noise_density)

    def variance_coefficients(self, model: CovarianceModel) -> tuple[float, float, float]:
        """``(c0, c1, c2)`` of the variance ``c0 + c1 rate + c2 rate**2`` [(rad/s)**2] of the calibrated rate."""
        inverse = 1.0 / self.scale_factor**2
        constant = model.constant_weight * inverse
        white = self.noise_density**2 * model.white_bandwidth_hz * inverse
        return white + constant * self.bias_sd_rad_s**2, 2.0 * constant * self.covariance_rad_s, constant * self.scale_factor_sd**2
