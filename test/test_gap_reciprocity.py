"""A cross stiffness that is not symmetric, from the constants of a linear device and what a rate does to its pick-offs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from table_samples import looked_at, on_a_table, table_model

from gyro_calib.device import J
from gyro_calib.gap import reciprocity as module
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.reciprocity import circulatory_stiffness, reciprocity
from gyro_calib.gap.system import Solution

K = 0.02


def said(model: CampaignModel, found: tuple[str, ...] = (), without: tuple[str, ...] = ()) -> tuple[Any, Any]:
    return reciprocity(model.evidence, model.base, model.linear.angular_gain, found, without)


def test_whatever_the_pickoffs_are_it_is_what_stands_between_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains 4 % apart, phases 0.03 rad, angles 2 degrees: of a symmetric stiffness nothing is left, of the other one all, and its sd."""
    P = np.array([[1.02 * np.exp(0.02j), 0.03], [-0.01, 0.98 * np.exp(-0.01j)]])
    symmetric = 1j * np.array([[0.9, 0.4], [0.4, -0.9]]) - np.array([[1.5, 0.02], [0.02, 1.4]])
    reaction = P @ J @ np.linalg.inv(P)
    for k in (0.0, K):

        def linear_of(_: object, values: dict[str, float], gain: float, k: float = k) -> SimpleNamespace:
            A = P @ (symmetric + 1j * k * J - 0.8 * 1e-4 * J) @ np.linalg.inv(P)
            return SimpleNamespace(A=A + 1j * values["A_xy_im"] * np.array([[0, 1], [0, 0]]), reaction=reaction)

        monkeypatch.setattr(module, "linear_of", linear_of)
        solution = SimpleNamespace(
            columns=(SimpleNamespace(name="A_xy_im"),), covariance=np.array([[1e-8]]), by_name=lambda: {"A_xy_im": 0.0}
        )
        told = circulatory_stiffness(cast(CampaignEvidence, None), cast(Solution, solution), 0.8)
        assert told.value == pytest.approx(k, abs=1e-12)
        # half of what one element may be, and what is not linear
        assert told.sd == pytest.approx(np.hypot(0.5e-4 * abs(reaction[1, 0]), 1e-4 * 0.9), rel=0.06)


def test_a_healthy_ring_has_none_and_says_how_much_would_have_been_seen() -> None:
    effects, (line,) = said(table_model())
    assert effects == ()
    assert line.status == "excluded"
    assert line.excluded_above is not None
    assert line.excluded_above.value < 0.1 * K


def test_one_of_the_carrier_is_found_with_its_size() -> None:
    """A linear device takes it for its own, so nothing is left of it in any residual."""
    model = looked_at(on_a_table("circulatory_stiffness", k=K))
    (effect,), (line,) = said(model)
    assert effect.name == "circulatory_stiffness"
    assert line.status == "present"
    k = effect.parameters["k"]
    assert abs(k.value - K) < 4.0 * k.sd < 0.05 * K
    assert said(model, without=("circulatory_stiffness",)) == ((), ())


def test_where_the_table_does_not_tell_the_pickoffs_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    _, (line,) = said(table_model(), found=("multiplexing_skew",))
    assert line.status == "not testable"
    assert said(table_model(), found=("duffing",))[1][0].status == "excluded"
    monkeypatch.setattr(module, "is_turned", lambda recording: False)
    assert said(table_model())[1][0].status == "not testable"
