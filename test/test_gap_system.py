"""Least squares with priors against closed forms, and columns that are nearly one another's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from gyro_calib.gap.column import Column
from gyro_calib.gap.factored import factored
from gyro_calib.gap.screen import Candidate, Screener
from gyro_calib.gap.system import Whitener, solve, with_priors

ROWS = 40


def unknowns(*prior_sd: float) -> list[Column]:
    return [Column(f"c_{k}", (), (), sd) for k, sd in enumerate(prior_sd)]


def design(columns: int, seed: int = 1) -> NDArray[np.float64]:
    """Of sizes that differ by nine orders: a column in volts beside one in parts of a million."""
    return np.random.default_rng(seed).standard_normal((ROWS, columns)) * np.geomspace(1e-5, 1e4, columns)


def test_values_and_covariance_are_those_of_the_normal_equations() -> None:
    a, priors = design(5), (np.inf, 2.0, 0.3, np.inf, 1e-5)
    x = np.array([3e4, 1.0, -0.1, 2e-3, 1e-5])
    target = a @ x + np.random.default_rng(2).standard_normal(ROWS)
    found = solve(unknowns(*priors), a, target)
    weight = np.diag([0.0 if np.isinf(sd) else sd**-2 for sd in priors])
    covariance = np.linalg.inv(a.T @ a + weight)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6)
    np.testing.assert_allclose(found.values, covariance @ a.T @ target, rtol=1e-6)
    left = target - a @ found.values
    np.testing.assert_allclose(found.residual, left, atol=1e-9)
    assert found.chi2 == pytest.approx(left @ left + found.values @ weight @ found.values, rel=1e-9)
    # leverages: how far a row is followed
    np.testing.assert_allclose(np.sum(found.basis**2, axis=1), np.diag(a @ covariance @ a.T), rtol=1e-6)


@pytest.mark.parametrize("gap", [0.0, 1e-13])
def test_of_columns_that_are_one_each_has_half_and_no_more_certainty_than_both(gap: float) -> None:
    a = design(3)
    twin = a[:, 1] * (1.0 + gap * np.arange(ROWS))
    both = np.column_stack([a, twin, np.zeros(ROWS)])
    target = a @ np.array([1e5, 2.0, 1e-4])
    found = solve(unknowns(*[np.inf] * 5), both, target)
    np.testing.assert_allclose(found.values, [1e5, 1.0, 1e-4, 1.0, 0.0], rtol=1e-6, atol=1e-9)
    assert np.sum(found.basis**2) == pytest.approx(3.0)
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-7 * np.abs(target).max())


def test_more_unknowns_than_equations_have_the_least_values() -> None:
    a = np.random.default_rng(3).standard_normal((4, 7))
    a /= np.linalg.norm(a, axis=0)
    basis, factor = factored(a, 4)
    target = np.array([1.0, -2.0, 0.5, 3.0])
    np.testing.assert_allclose(factor @ (basis.T @ target), np.linalg.pinv(a) @ target, rtol=1e-9)


def of_recordings(rng: np.random.Generator, *, twins: bool) -> tuple[np.ndarray, int]:
    """Thirty recordings of ten equations with three columns of their own, twenty of all, priors below; in any order."""
    own = scipy.linalg.block_diag(*rng.standard_normal((30, 10, 3)))
    of_all = rng.standard_normal((300, 20))
    # all but a recording's own, and where nothing tells them apart
    of_all[:, 3] = own[:, 7] + 1e-6 * of_all[:, 3]
    if twins:
        of_all[:, 5], own[:, 31] = own[:, 4] - 2.0 * of_all[:, 6], own[:, 30]
    prior = np.diag(np.where(rng.random(110) < 0.7 - twins, 0.3, 0.0))
    full = np.concatenate([np.hstack([own, of_all]), prior[prior.any(axis=1)]])
    return full[:, rng.permutation(110)] * np.exp(3.0 * rng.standard_normal(110)), 300


@pytest.mark.parametrize("twins", [False, True])
def test_columns_of_one_recording_taken_first_are_the_same_least_squares(twins: bool) -> None:
    rng = np.random.default_rng(11)
    full, equations = of_recordings(rng, twins=twins)
    basis, factor = factored(full, equations)
    target = rng.standard_normal(len(full))
    # columns that no recording has alone: without rows to tell which are
    dense, values = factored(full, 1)
    assert basis.shape == dense.shape == (len(full), 108 if twins else 110)
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-9)
    np.testing.assert_allclose(basis @ (basis.T @ full), full, atol=1e-9 * np.abs(full).max())
    np.testing.assert_allclose(basis @ (basis.T @ target), dense @ (dense.T @ target), atol=1e-8)
    norms = np.linalg.norm(full, axis=0)
    # two columns a millionth apart: what a double holds of their covariance is some 1e12 times its rounding, by the processor
    np.testing.assert_allclose(
        (factor @ factor.T) * np.outer(norms, norms), (values @ values.T) * np.outer(norms, norms), rtol=2e-3, atol=1e-4
    )
    if not twins:
        np.testing.assert_allclose(factor @ (basis.T @ target), np.linalg.lstsq(full, target, rcond=None)[0], rtol=1e-5)


def test_a_prior_is_a_row_below() -> None:
    rows = with_priors(unknowns(np.inf, 0.5), np.ones((2, 2)))
    np.testing.assert_array_equal(rows, [[1.0, 1.0], [1.0, 1.0], [0.0, 2.0]])


def test_candidates_screened_together_are_as_each_alone() -> None:
    rng, rows, count = np.random.default_rng(5), 12, 3

    def column(name: str) -> Column:
        return Column(name, tuple(rng.standard_normal(rows) + 1j * rng.standard_normal(rows) for _ in range(count)), ())

    nuisance, shapes = column("one"), [column(f"c_{k}") for k in range(4)]
    target = [n + 5.0 * s for n, s in zip(nuisance.signal, shapes[0].signal, strict=True)]
    absent = Column("none", tuple(np.zeros(rows, dtype=complex) for _ in range(count)), ())
    tried = [
        Candidate("duffing", {}, (shapes[0],), np.array([10.0])),
        Candidate("drive_sag", {}, (absent,), np.array([10.0])),
        Candidate("drive_nonlinearity", {}, (shapes[1], shapes[2]), np.array([1.0, 2.0])),
        Candidate("nonlinear_damping", {}, (shapes[3], shapes[0]), np.array([1.0, 2.0])),
    ]
    screener = Screener(Whitener(tuple((np.eye(rows), np.eye(rows)) for _ in range(count))), [nuisance], target)
    alone = [found for c in tried if (found := screener.screen(c)) is not None]
    together = screener.screened(iter(tried))
    assert [s.candidate for s in together] == [tried[0], tried[2], tried[3]]
    for one, other in zip(alone, together, strict=True):
        assert one.log_evidence == pytest.approx(other.log_evidence, rel=1e-9)
        np.testing.assert_allclose(one.values, other.values, rtol=1e-9)
        np.testing.assert_allclose(one.sd, other.sd, rtol=1e-9)
    assert together[0].values == pytest.approx(5.0)
    assert screener.screened([]) == []


@pytest.mark.parametrize(
    ("nuisance", "effect"),
    [
        ("rate_mismatch_im", "multiplexing_skew"),
        ("rate_anti_re", "angular_gain_error"),
        ("frequency_per_k2", "thermal_frequency_curvature"),
        ("thermal_split.k_c", "thermal_split"),
    ],
)
def test_a_healthy_nuisance_imitates_its_own_effect_but_for_its_prior(nuisance: str, effect: str) -> None:
    """Told to a part in 30 000 of what a healthy device may have, and 42 times that: an effect, and of any other name none."""
    rng, rows, prior_sd, size = np.random.default_rng(7), 40, 1.0, 42.0
    shape = 3e3 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    noise = rng.standard_normal(rows) + 1j * rng.standard_normal(rows)
    healthy = Column(nuisance, (shape,), (), prior_sd)
    screener = Screener(Whitener(((np.eye(rows), np.eye(rows)),)), [healthy], [size * shape + noise])
    found = screener.screen(Candidate(effect, {}, (replace(healthy, name="c", prior_sd=np.inf),), np.array([1e3])))
    assert found is not None
    assert abs(found.values[0] - size) < 3.0 * found.sd[0] < 4.0
    assert found.log_evidence > 500.0
    assert screener.screen(Candidate("duffing", {}, found.candidate.columns, np.array([1e3]))) is None
