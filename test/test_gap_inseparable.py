"""What no recording tells apart stands in one group: a resonator that ages and a clock that drifts."""

from __future__ import annotations

from table_samples import table_model

from gyro_calib.effects import EFFECTS, INSEPARABLE
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.diagnose import _found
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.select import select_effects
from gyro_calib.gap.standing import standings
from gyro_calib.trial.injected import with_columns

AGEING_RAD_S2 = 2e-3


def test_an_ageing_resonator_may_be_a_drifting_clock() -> None:
    healthy = table_model()
    (column,) = form_columns(healthy.evidence, FORMS["frequency_ageing"], healthy.linear, {})
    model = with_columns(healthy, [(column, AGEING_RAD_S2)])
    selection = select_effects(model)
    assert [e.name for e in selection.effects] == ["frequency_ageing"]
    found = _found(model, selection, 0, model.fitted([e.candidate for e in selection.effects]))
    assert found.group[0] == "frequency_ageing"
    assert "clock_drift" in found.group
    rich = model.fitted([e.candidate for e in selection.effects])
    assert "clock_drift" not in _found(model, selection, 0, rich, ("clock_drift",)).group
    lines = {s.name: s for s in standings(model, selection)}
    assert lines["clock_drift"].status == "like frequency_ageing"
    assert lines["clock_drift"].title == EFFECTS["clock_drift"].title
    assert "clock_drift" not in {s.name for s in standings(model, selection, ("clock_drift",))}


def test_without_either_both_are_excluded() -> None:
    model = table_model()
    lines = {s.name: s for s in standings(model, select_effects(model))}
    assert lines["clock_drift"].status == lines["frequency_ageing"].status


def test_the_registry_knows_both_of_each_pair() -> None:
    for known, others in INSEPARABLE.items():
        assert {known, *others} <= set(EFFECTS)
        assert known in FORMS
        # one candidate stands for all of them
        assert not set(others) & set(FORMS)
