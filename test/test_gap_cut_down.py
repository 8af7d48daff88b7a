"""Parts of the practice campaigns, as somebody with less time would record them: the verdict may not become a wrong one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from recording_samples import BENCH

from gyro_calib.gap import diagnose
from gyro_calib.recording import load_campaign
from gyro_calib.recording.recording import Recording

PARTS: dict[str, Callable[[Recording], bool]] = {
    "x alone": lambda r: r.command.oscillator_axis == "x",
    "no open drive": lambda r: r.command.mode != "loops_off",
    "free and precession alone": lambda r: r.label.startswith(("free", "vir")),
    "nothing warm, no table": lambda r: not r.label.startswith(("therm", "table")),
}


@pytest.mark.slow
@pytest.mark.skipif(not (BENCH / "truth.json").is_file(), reason="bench recordings are not here (GYRO_CALIB_BENCH)")
@pytest.mark.parametrize(
    ("name", "part", "effect"),
    [
        ("ring_a", "x alone", ""),
        ("ring_b", "x alone", "nonlinear_damping"),
        ("ring_a", "no open drive", ""),
        ("ring_b", "no open drive", "nonlinear_damping"),
        ("ring_b", "nothing warm, no table", "nonlinear_damping"),
        ("hrg_a", "free and precession alone", ""),
        ("hrg_b", "free and precession alone", "pickoff_nonlinearity"),
        ("hrg_b", "no open drive", "pickoff_nonlinearity"),
        ("hrg_a", "nothing warm, no table", ""),
    ],
)
def test_a_cut_down_campaign_is_not_misjudged(name: str, part: str, effect: str) -> None:
    whole = load_campaign(BENCH / f"{name}.h5")
    kept = replace(whole, recordings=tuple(r for r in whole if PARTS[part](r)))
    assert 5 < len(kept) < len(whole)
    found = diagnose(kept)
    if effect:
        assert found.verdict == "effects"
        assert [e.name for e in found.effects] == [effect]
    else:
        # with little to go by it may also say that nothing can be tested
        assert found.verdict in ("none", "not_testable")
