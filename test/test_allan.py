"""Allan deviation against closed forms, an independent package and its own claimed uncertainty."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import fftconvolve, lfilter

from gyro_calib.errors import DataError
from gyro_calib.estimation.allan import allan_variance, analyse_allan, averaging_factors
from gyro_calib.estimation.power_law import COEFFICIENT_UNITS, AllanCovariance, model_variance

RATE_HZ = 10.0
SAMPLES = 4000


def white(rng, coefficient, samples=SAMPLES):
    return coefficient * math.sqrt(RATE_HZ) * rng.standard_normal(samples)


def random_walk(rng, coefficient, samples=SAMPLES):
    return np.cumsum(coefficient / math.sqrt(RATE_HZ) * rng.standard_normal(samples))


def angle_noise(rng, coefficient, samples=SAMPLES):
    return np.diff(coefficient * rng.standard_normal(samples + 1)) * RATE_HZ


def flicker(rng, coefficient, samples=SAMPLES):
    """Half-integrated white noise (Kasdin 1995): two-sided density B^2/(2 pi f)."""
    k = np.arange(1, 4 * samples)
    response = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    return coefficient * fftconvolve(rng.standard_normal(5 * samples), response)[4 * samples : 5 * samples]


NOISES = {"angle_noise": angle_noise, "angle_random_walk": white, "bias_instability": flicker, "rate_random_walk": random_walk}


def test_definition_by_direct_averaging():
    """The cumulative-sum formula against averages and differences spelled out."""
    rate = np.random.default_rng(3).standard_normal(60) + 1e6
    for m in (1, 2, 7):
        means = np.array([rate[k : k + m].mean() for k in range(rate.size - m + 1)])
        expected = 0.5 * np.mean((means[m:] - means[:-m]) ** 2)
        assert allan_variance(rate, RATE_HZ, [m])[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", NOISES)
def test_closed_form_of_each_noise(name):
    """Mean over seeds of the Allan variance against the closed form, in units of the predicted scatter."""
    coefficient, seeds = 0.7, 60
    factors = np.array([1, 4, 16, 64, 256])
    squares = np.array([coefficient**2 if key == name else 0.0 for key in NOISES])
    runs = np.array([allan_variance(NOISES[name](np.random.default_rng(s), coefficient), RATE_HZ, factors) for s in range(seeds)])
    expected = model_variance(factors / RATE_HZ) @ squares
    sd = np.sqrt(np.diag(AllanCovariance(factors, SAMPLES, RATE_HZ)(squares)))
    # A sampled flicker or random walk differs from the continuous one by O(1/m).
    first = {"bias_instability": 2, "rate_random_walk": 2}.get(name, 0)
    pull = (runs.mean(axis=0) - expected) / (sd / math.sqrt(seeds))
    assert np.abs(pull[first:]).max() < 4.0
    assert runs.std(axis=0)[first:] == pytest.approx(sd[first:], rel=0.45)


def test_linear_drift_has_its_closed_form():
    """Ramp R: sigma = R tau / sqrt(2)."""
    ramp = 3e-4 * np.arange(400) / RATE_HZ
    assert np.sqrt(allan_variance(ramp, RATE_HZ, [5, 50])) == pytest.approx(3e-4 * np.array([0.5, 5.0]) / math.sqrt(2.0), rel=1e-9)


def test_against_allantools():
    allantools = pytest.importorskip("allantools")
    rate = white(np.random.default_rng(5), 1.0) + random_walk(np.random.default_rng(6), 0.1)
    factors = averaging_factors(rate.size)
    _, deviation, _, _ = allantools.oadev(rate, rate=RATE_HZ, data_type="freq", taus=factors / RATE_HZ)
    assert np.sqrt(allan_variance(rate, RATE_HZ, factors)) == pytest.approx(deviation, rel=1e-10)


def degrees_of_freedom(index, m):
    variance = AllanCovariance([m], SAMPLES, RATE_HZ)(np.eye(4)[index])[0, 0]
    return 2.0 * model_variance(m / RATE_HZ)[0, index] ** 2 / variance


def test_degrees_of_freedom_in_closed_form():
    """m = 1: neighbouring second differences of white angle noise correlate by -2/3 and 1/6, of white rate noise by -1/2."""
    count = SAMPLES - 1
    assert degrees_of_freedom(0, 1) == pytest.approx(count / (1.0 + 2.0 * (4 / 9 + 1 / 36)), rel=1e-3)
    assert degrees_of_freedom(1, 1) == pytest.approx(count / (1.0 + 2.0 / 4.0), rel=1e-3)


@pytest.mark.parametrize("m", [1, 4, 16, 100])
def test_degrees_of_freedom_against_nist(m):
    """NIST SP 1065, table 5, white noise of the rate; n counts the angle samples."""
    n = SAMPLES + 1
    expected = (3.0 * (n - 1) / (2.0 * m) - 2.0 * (n - 2) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    assert degrees_of_freedom(1, m) == pytest.approx(expected, rel=0.01)


def test_degrees_of_freedom_against_greenhall_and_riley():
    """The published approximation, as allantools implements it."""
    ci = pytest.importorskip("allantools.ci")
    for index, alpha in ((1, 0), (2, -1), (3, -2)):
        for m in (16, 100, 500):
            expected = ci.edf_greenhall(alpha=alpha, d=2, m=m, N=SAMPLES + 1, overlapping=True, modified=False)
            assert degrees_of_freedom(index, m) == pytest.approx(expected, rel=0.1)


def test_few_lags_give_the_same_covariance(monkeypatch):
    """The sparse sum over lags against the sum over every lag."""
    mix, factors = [0.04, 1.0, 0.02, 4e-4], [1, 3, 40, 300, 1000]
    sparse = AllanCovariance(factors, SAMPLES, RATE_HZ)(mix)
    monkeypatch.setattr("gyro_calib.estimation.power_law._LAGS", 10**9)
    assert sparse == pytest.approx(AllanCovariance(factors, SAMPLES, RATE_HZ)(mix), rel=2e-3)


def test_coefficients_are_as_sure_as_they_say():
    """Error over claimed sd, and coverage of the intervals, over seeds."""
    truth = {"angle_noise": 0.2, "angle_random_walk": 1.0, "bias_instability": 0.3, "rate_random_walk": 0.1}
    pulls, inside = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        rate = sum(make(rng, truth[name]) for name, make in NOISES.items())
        result = analyse_allan(rate, RATE_HZ)
        pulls.append([(result.coefficients[k].value - truth[k]) / result.coefficients[k].sd for k in truth])
        expected = np.sqrt(model_variance(result.curve.tau_s) @ np.array([v**2 for v in truth.values()]))
        inside.append((result.curve.lower < expected) & (expected < result.curve.upper))
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all(rms[:2] < 1.7)
    assert np.all(rms[:2] > 0.5)
    assert np.all(rms[2:] < 2.5)
    assert 0.88 < np.mean(inside) < 1.0


def test_fit_begins_where_the_model_holds():
    """A loop filter shapes the short end; the angle random walk must not feel it, and the analysis says where it began."""
    rng = np.random.default_rng(11)
    rate = lfilter([0.1], [1.0, -0.9], white(rng, 0.5, 20000)) + lfilter([0.2], [1.0, -0.8], angle_noise(rng, 2.0, 20000))
    result = analyse_allan(rate, RATE_HZ)
    forced = analyse_allan(rate, RATE_HZ, min_tau_s=0.0)
    walk = result.coefficients["angle_random_walk"]
    assert abs(walk.value - 0.5) < 4.0 * walk.sd
    assert walk.sd < 0.05
    assert 0.3 < result.min_tau_s < 20.0
    assert result.chi_square_per_dof < 2.0
    assert forced.chi_square_per_dof > 10.0
    assert forced.min_tau_s == 1.0 / RATE_HZ
    assert result.curve.tau_s[0] == forced.curve.tau_s[0] == 1.0 / RATE_HZ


def test_white_noise_alone_leaves_the_slow_noises_unobservable():
    result = analyse_allan(white(np.random.default_rng(2), 0.5), RATE_HZ)
    assert result.coefficients["angle_random_walk"].value == pytest.approx(0.5, rel=0.05)
    assert {"bias_instability", "rate_random_walk"} <= set(result.not_observable)
    assert "angle_random_walk" not in result.not_observable
    assert 0.0 < result.upper_limits["bias_instability"] < 0.5
    assert 0.2 < result.chi_square_per_dof < 3.0


def test_model_deviation_and_minimum():
    result = analyse_allan(white(np.random.default_rng(2), 0.5) + random_walk(np.random.default_rng(3), 0.05), RATE_HZ)
    expected = np.sqrt(model_variance(4.0) @ np.array([result.coefficients[k].value ** 2 for k in COEFFICIENT_UNITS]))
    assert result.model_deviation(4.0) == pytest.approx(expected)
    tau, deviation = result.curve.minimum()
    assert deviation.value == result.curve.deviation.min()
    assert tau in result.curve.tau_s
    assert 0.0 < deviation.sd < deviation.value


@pytest.mark.parametrize(
    ("rate", "options", "message"),
    [
        (np.zeros(100), {}, "must vary"),
        (np.ones(4), {}, "16 or more samples"),
        (np.ones((20, 2)), {}, "one column"),
        (np.r_[np.random.default_rng(0).standard_normal(30), np.nan], {}, "sample 30 is nan"),
        (np.random.default_rng(0).standard_normal(64), {"min_tau_s": 5.0}, "5 averaging times above 5 s"),
        (np.random.default_rng(0).standard_normal(64), {"confidence": 1.0}, "between 0 and 1"),
    ],
)
def test_refusals(rate, options, message):
    with pytest.raises(DataError, match=message):
        analyse_allan(rate, RATE_HZ, **options)


def test_refuses_bad_sample_rate_and_factor():
    with pytest.raises(DataError, match="sample_rate_hz must be > 0"):
        analyse_allan(np.arange(40.0), 0.0)
    with pytest.raises(DataError, match="must be in 1…20 for 40 samples, but got 21"):
        allan_variance(np.arange(40.0), 1.0, [21])
