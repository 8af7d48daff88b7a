"""Non-negative sizes of densities: against scipy's solver in the same rounds, and against the likelihood itself."""

import numpy as np
import pytest
from scipy.optimize import minimize, nnls

from gyro_calib.gap.whittle import likeliest, likeliest_of_each

MODELS = ((0,), (0, 1), (0, 2), (0, 3), (0, 1, 2), (0, 2, 3))


def drawn(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Densities of white, flicker, pick-off and walk at some frequencies, squares of a noise of some of them, and a known density."""
    f = np.exp(rng.uniform(np.log(0.05), np.log(200.0), n))
    basis = np.column_stack([np.ones(n), 1.0 / f, 1e-3 * f**2, f**-2.0]) * 10.0 ** rng.uniform(-14.0, 0.0)
    true = rng.choice([0.0, 1.0], 4) * 10.0 ** rng.uniform(-2.0, 2.0, 4) + [0.1, 0.0, 0.0, 0.0]
    known = rng.choice([0.0, 0.3]) * basis[:, 2]
    return basis, (basis @ true + known) * rng.chisquare(1, n), known


def by_rounds(basis: np.ndarray, squares: np.ndarray, known: np.ndarray | float) -> np.ndarray:
    size, expected, found = basis.mean(axis=0), np.full(squares.size, squares.mean()), np.zeros(basis.shape[1])
    for _ in range(15):
        before = found
        found, _ = nnls(basis / size / expected[:, None], (squares - known) / expected)
        if np.all(np.abs(found - before) <= 1e-4 * (before + found.max(initial=0.0))):
            break
        expected = np.maximum(basis / size @ found + known, 1e-6 * squares.mean())
    return np.asarray(found / size)


@pytest.mark.parametrize("n", [6, 40, 500])
def test_few_densities_are_those_of_a_general_solver(n: int) -> None:
    rng, zeros = np.random.default_rng(n), 0
    for _ in range(25):
        basis, squares, known = drawn(rng, n)
        for model, found in zip(MODELS, likeliest_of_each(MODELS, basis, squares, known), strict=True):
            expected = by_rounds(basis[:, model], squares, known)
            assert found[list(model)] * basis.mean(axis=0)[list(model)] == pytest.approx(
                expected * basis.mean(axis=0)[list(model)], rel=1e-7, abs=1e-9 * squares.mean()
            )
            zeros += int(np.sum(found[list(model)] == 0.0))
    assert zeros > 50  # the choices among fewer columns were asked


def test_they_are_where_the_likelihood_is_largest() -> None:
    basis, _, known = drawn(np.random.default_rng(3), 400)
    squares = basis @ [0.5, 0.4, 0.3, 0.0] * np.random.default_rng(4).chisquare(1, 400)
    found = likeliest_of_each(((0, 1, 2),), basis, squares, 0.0 * known)[0, :3]

    def surprise(log_sizes: np.ndarray) -> float:
        density = basis[:, :3] @ np.exp(log_sizes)
        return float(np.sum(np.log(density) + squares / density))

    best = minimize(surprise, np.log([0.3, 0.3, 0.3]), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9, "maxiter": 4000})
    assert best.success
    assert found == pytest.approx(np.exp(best.x), rel=3e-3)


def test_many_densities_are_those_of_a_general_solver() -> None:
    rng = np.random.default_rng(5)
    basis = rng.uniform(0.0, 1.0, (600, 12)) * 10.0 ** rng.uniform(-6.0, 0.0, 12)
    squares = basis @ (rng.choice([0.0, 1.0], 12) / basis.mean(axis=0)) * rng.chisquare(1, 600)
    assert likeliest(basis, squares) * basis.mean(axis=0) == pytest.approx(
        by_rounds(basis, squares, 0.0) * basis.mean(axis=0), rel=1e-6, abs=1e-8 * squares.mean()
    )


def test_densities_that_are_alike_or_nothing_do_not_stop_it() -> None:
    squares = np.random.default_rng(6).chisquare(1, 50)
    same = np.column_stack([np.ones(50), np.ones(50), np.zeros(50), np.linspace(1.0, 2.0, 50)])
    for found in likeliest_of_each(((0, 1), (0, 2), (0, 1, 2), (0, 1, 3)), same, squares, np.zeros(50)):
        assert np.all(np.isfinite(found))
        assert np.all(found >= 0.0)
        assert float(np.mean(same @ found)) == pytest.approx(squares.mean(), rel=0.05)
    assert float(np.mean(same @ likeliest(same, squares))) == pytest.approx(squares.mean(), rel=0.05)
