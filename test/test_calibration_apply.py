"""Applying a calibration: the right numbers once, and variances that the errors of many simulated gyros agree with."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from calibration_samples import make_record

from gyro_calib.calibration import CorrectedRate, Corrector, CovarianceModel, RateErrorModel, SenseAxes, validity_problems
from gyro_calib.errors import DataError
from gyro_calib.quantity import Quantity
from gyro_calib.units import DEG_H, PPM

DEVICE = "ring_15k-0007"


def test_rate_is_corrected() -> None:
    record = make_record()
    corrector = Corrector(record, device_id=DEVICE)
    truth = np.array([[-0.1, 0.0], [1e-4, 2.0]])
    corrected = corrector.apply(1.03 * truth + 1200.0 * DEG_H)
    np.testing.assert_allclose(corrected.rate_rad_s, truth, rtol=0.0, atol=1e-15)
    assert (corrected.device_id, corrected.record_id) == (DEVICE, record.record_id)
    rate, variance = corrector.apply_scalar(1.03 * 2.0 + 1200.0 * DEG_H)
    assert rate == pytest.approx(2.0, abs=1e-15)
    assert variance == pytest.approx(corrected.variance[1, 1], rel=1e-12)


def test_rate_is_corrected_only_once() -> None:
    corrector = Corrector(make_record(), device_id=DEVICE)
    corrected = corrector.apply([0.1, 0.2])
    assert isinstance(corrected, CorrectedRate)
    with pytest.raises(DataError, match=f"must be raw, but got one corrected by record '{corrected.record_id}'"):
        corrector.apply(corrected)  # type: ignore[arg-type]


def test_another_device_is_refused() -> None:
    with pytest.raises(DataError, match=r"must belong to device 'other', but got 'ring_15k-0007-2026.*' of device 'ring_15k-0007'"):
        Corrector(make_record(), device_id="other")


def test_sample_that_is_not_finite_is_named() -> None:
    with pytest.raises(DataError, match="sample 2 is nan"):
        Corrector(make_record(), device_id=DEVICE).apply([0.0, 1.0, np.nan])


def test_covariance_arguments_are_checked() -> None:
    with pytest.raises(DataError, match="mode must be one of white, total, horizon, but got 'best'"):
        CovarianceModel("best")
    for name in ("sample_rate_hz", "bandwidth_hz", "horizon_s"):
        with pytest.raises(DataError, match=f"{name} must be > 0"):
            CovarianceModel(**{name: 0.0})


def test_variances_by_hand() -> None:
    """K = 2, so that every place of K shows; S = 1e-4, 100 samples a second, rate 3 rad/s."""
    errors = RateErrorModel(0.0, 1e-3, 2.0, 1e-2, 5e-6, 1e-4)
    rate = 3.0
    constant = (1e-6 + 9.0 * 1e-4 + 2.0 * 3.0 * 5e-6) / 4.0
    white = 1e-8 * 50.0 / 4.0
    for model, expected in [
        (CovarianceModel("white", 100.0), white),
        (CovarianceModel("white", 100.0, bandwidth_hz=10.0), white / 5.0),
        (CovarianceModel("total", 100.0), white + constant),
        (CovarianceModel("horizon", 100.0, bandwidth_hz=10.0, horizon_s=20.0), white + constant * 20.0 * 100.0),
    ]:
        c0, c1, c2 = errors.variance_coefficients(model)
        assert c0 + c1 * rate + c2 * rate**2 == pytest.approx(expected, rel=1e-12)


def test_drift_and_doubt_widen_the_bias() -> None:
    record = make_record()
    plain = RateErrorModel.from_record(record)
    wide = RateErrorModel.from_record(record, bias_drift_sd_rad_s=3.0 * DEG_H, sd_factor=4.0)
    assert wide.bias_sd_rad_s == pytest.approx(5.0 * DEG_H)
    assert wide.scale_factor_sd == pytest.approx(4.0 * plain.scale_factor_sd)
    assert wide.covariance_rad_s == pytest.approx(16.0 * plain.covariance_rad_s)
    assert (wide.bias_rad_s, wide.noise_density) == (plain.bias_rad_s, plain.noise_density)


class Gyros:
    """Many gyros whose bias and scale factor scatter as their common record says, all turning at one rate."""

    count = 4000
    sample_rate_hz = 20.0
    rate = 0.3

    def __init__(self) -> None:
        self.record = make_record(
            bias=Quantity(1e-3, 2e-4, "rad/s"),
            scale_factor=Quantity(1.25, 2e-3, "1"),
            bias_scale_covariance=-0.7 * 2e-4 * 2e-3,
            rate_noise_density=Quantity(1e-4, 0.0, "rad/s/sqrt(Hz)"),
        )
        rng = np.random.default_rng(7)
        rho_part = -0.7 * 2e-4 * 2e-3
        b, k = rng.multivariate_normal([1e-3, 1.25], [[4e-8, rho_part], [rho_part, 4e-6]], self.count).T
        # one-sided density S sampled at fs: variance S^2 fs / 2
        noise = 1e-4 * np.sqrt(self.sample_rate_hz / 2.0) * rng.standard_normal((self.count, 200))
        self.raw = k[:, None] * self.rate + b[:, None] + noise

    def corrected(self, mode: str, horizon_s: float = 10.0) -> CorrectedRate:
        model = CovarianceModel(mode, self.sample_rate_hz, horizon_s=horizon_s)
        return Corrector(self.record, device_id=DEVICE, covariance=model).apply(self.raw)


@pytest.fixture(scope="module")
def gyros() -> Gyros:
    return Gyros()


def ratio(errors: np.ndarray, variance: np.ndarray) -> float:
    """Mean square of errors over their claimed sd; 1 for an honest claim, its own sd is sqrt(2/4000) = 0.022."""
    return float(np.mean(errors**2 / variance))


def test_total_is_the_variance_of_one_sample(gyros: Gyros) -> None:
    found = gyros.corrected("total")
    assert ratio(found.rate_rad_s[:, 0] - gyros.rate, found.variance[:, 0]) == pytest.approx(1.0, abs=0.1)


def test_white_is_the_variance_of_differences_only(gyros: Gyros) -> None:
    found = gyros.corrected("white")
    differences = np.diff(found.rate_rad_s, axis=1)
    assert ratio(differences, 2.0 * found.variance[:, 1:]) == pytest.approx(1.0, abs=0.02)
    assert ratio(found.rate_rad_s[:, 0] - gyros.rate, found.variance[:, 0]) > 3.0


def test_horizon_makes_independent_integration_honest(gyros: Gyros) -> None:
    """A consumer that adds variances of samples as if they were independent gets the angle variance right at T, not before or after."""
    found = gyros.corrected("horizon", horizon_s=5.0)
    interval = 1.0 / gyros.sample_rate_hz

    def angle_ratio(duration_s: float, claim: CorrectedRate) -> float:
        n = round(duration_s * gyros.sample_rate_hz)
        angle = claim.rate_rad_s[:, :n].sum(axis=1) * interval - gyros.rate * duration_s
        return ratio(angle, claim.variance[:, :n].sum(axis=1) * interval**2)

    assert angle_ratio(5.0, found) == pytest.approx(1.0, abs=0.1)
    assert angle_ratio(1.0, found) < 0.5
    assert angle_ratio(10.0, found) > 1.5
    assert angle_ratio(5.0, gyros.corrected("total")) > 20.0


def test_scale_factor_variance_grows_with_the_rate() -> None:
    record = make_record(bias_scale_covariance=0.0, rate_noise_density=Quantity(0.0, 0.0, "rad/s/sqrt(Hz)"))
    corrected = Corrector(record, device_id=DEVICE).apply(np.array([0.0, 10.0]) * 1.03 + 1200.0 * DEG_H)
    assert np.sqrt(corrected.variance) * 1.03 == pytest.approx([1.0 * DEG_H, np.hypot(10.0 * 30.0 * PPM, DEG_H)], rel=1e-9)


def test_validity() -> None:
    record = make_record()
    noon = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
    assert validity_problems(record, temperature_degc=25.0, now=noon, mode="ftr_x", compensation=(1.0, 0.0, 0.0, 1.0)) == ()
    assert validity_problems(record) == ()
    for conditions, message in [
        ({"temperature_degc": 30.1}, "Temperature must be 20 to 30 degC, but got 30.1 degC"),
        ({"temperature_degc": 19.9}, "but got 19.9 degC"),
        ({"temperature_degc": float("nan")}, "but got nan degC"),
        ({"now": noon + timedelta(days=2)}, "at most 86400 s old, but got 172800 s"),
        ({"now": datetime(2026, 3, 3, 12)}, "but got 172800 s"),
        ({"mode": "ftr_y"}, "Mode must be 'ftr_x', but the gyro runs 'ftr_y'"),
        ({"compensation": (1.0, 0.1, 0.0, 1.0)}, "Drive compensation must be"),
    ]:
        (problem,) = validity_problems(record, **conditions)
        assert message in problem
    assert validity_problems(make_record(validity={}), temperature_degc=-100.0, now=noon + timedelta(days=9999)) == ()


# --- sense axes ----------------------------------------------------------------------------------------------------------------


def test_one_axis_leaves_the_others_open() -> None:
    axes = SenseAxes([[0.0, 0.0, 2.0]], unsensed_sd_rad_s=10.0)
    np.testing.assert_allclose(axes.angular_velocity([0.5]), [0.0, 0.0, 0.5], atol=1e-15)
    np.testing.assert_allclose(axes.covariance([0.04]), np.diag([100.0, 100.0, 0.04]), atol=1e-12)


def test_two_axes_leave_their_normal_open() -> None:
    axes = SenseAxes([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]], unsensed_sd_rad_s=10.0)
    omega = np.array([0.3, -0.2, 0.0])
    np.testing.assert_allclose(axes.angular_velocity(axes.matrix @ omega), omega, atol=1e-15)
    covariance = axes.covariance([0.0, 0.0])
    np.testing.assert_allclose(covariance, np.diag([0.0, 0.0, 100.0]), atol=1e-9)


def test_skewed_triad_by_monte_carlo() -> None:
    rng = np.random.default_rng(3)
    axes = SenseAxes([[1.0, 0.1, 0.0], [-0.05, 1.0, 0.2], [0.0, 0.3, -1.0]])
    variances = np.array([1e-4, 4e-4, 9e-4])
    omega = np.array([0.1, -0.2, 0.3])
    rates = axes.matrix @ omega + np.sqrt(variances) * rng.standard_normal((20000, 3))
    found = rates @ axes.inverse.T
    np.testing.assert_allclose(found.mean(axis=0), omega, atol=1e-3)
    np.testing.assert_allclose(np.cov(found.T), axes.covariance(variances), atol=4e-5)
    np.testing.assert_allclose(axes.unsensed_covariance, 0.0, atol=0.0)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ([1.0, 0.0, 0.0], "must have shape"),
        (np.eye(4, 3), "must have shape"),
        ([[0.0, 0.0, 0.0]], "must be finite and not zero"),
        ([[np.nan, 0.0, 0.0]], "must be finite and not zero"),
        ([[1.0, 0.0, 0.0], [1.0, 0.001, 0.0]], "must point in different directions"),
    ],
)
def test_axes_that_make_no_sense_are_refused(axes, message: str) -> None:
    with pytest.raises(DataError, match=message):
        SenseAxes(axes)
    with pytest.raises(DataError, match="unsensed_sd_rad_s must be > 0"):
        SenseAxes([[0.0, 0.0, 1.0]], unsensed_sd_rad_s=0.0)
