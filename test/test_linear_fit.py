"""Noise densities of the linear fits: non-negative least squares against scipy's, drawn noise, and records without any."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from gyro_calib.estimation.linear_fit import _DENSITIES, _non_negative, fit_noise, fit_noises


def test_non_negative_sizes_are_those_of_an_active_set_search() -> None:
    """Subsets by their normal equations, and scipy's search on the rows themselves."""
    rng = np.random.default_rng(2)
    f = rng.uniform(0.2, 5.0, (60, 30))
    for lines in f:
        rows = np.column_stack([np.ones_like(lines), 1.0 / lines, lines**2, 1.0 / lines**2]) / rng.uniform(0.3, 3.0, 30)[:, None]
        right = rows @ np.maximum(rng.standard_normal(4), 0.0) + rng.standard_normal(30)
        gram, moments = (np.broadcast_to(x, (1, len(_DENSITIES), *x.shape)) for x in (rows.T @ rows, rows.T @ right))
        found = _non_negative(gram, moments)[0]
        for sizes, terms in zip(found, _DENSITIES, strict=True):
            expected = np.zeros(4)
            expected[list(terms)] = nnls(rows[:, terms], right)[0]
            np.testing.assert_allclose(sizes, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("coefficients", "walk"), [((3.0, 0.0, 0.0), 0.0), ((1.0, 0.0, 4.0), 0.0), ((0.5, 0.0, 0.0), 2.0)])
def test_a_drawn_density_is_found(coefficients: tuple[float, float, float], walk: float) -> None:
    rng, f, unit = np.random.default_rng(4), np.linspace(0.1, 4.0, 1500), 1e-14
    true = unit * (coefficients[0] + coefficients[2] * f**2 + walk / f**2)
    found = fit_noise(f, true * rng.standard_normal(f.size) ** 2, 0.05).density(f)
    assert np.abs(np.log(found / true)).max() < 0.25


def test_channels_are_fitted_each_by_itself_and_one_without_noise_has_none() -> None:
    rng, f = np.random.default_rng(5), np.linspace(0.1, 4.0, 40)
    squares = np.stack([1e-12 * rng.standard_normal(40) ** 2, np.zeros(40), 1e-220 * f**2 * rng.standard_normal(40) ** 2])
    together = fit_noises(f, squares, 0.05)
    assert together == [fit_noise(f, of_one, 0.05) for of_one in squares]
    assert np.all(together[1].density(f) == 0.0)
    assert np.all(together[2].density(f) > 0.0)
