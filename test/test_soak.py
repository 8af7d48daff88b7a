"""The soak of benchmarks/soak.py, short: three nodes as processes, a corrector at 1 kHz, every message checked, memory flat."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))


@pytest.fixture
def soak() -> Any:
    """The benchmark's module."""
    pytest.importorskip("rclpy")
    import soak

    return soak


def test_growth_is_what_remains_after_the_warm_up(soak: Any) -> None:
    times = np.linspace(0.0, 3600.0, 361)
    settling = np.column_stack([times, 80.0 + 20.0 * np.minimum(times / 600.0, 1.0)])
    assert soak.growth_mib(settling) == pytest.approx((0.0, 0.0), abs=1e-9)
    leaking = np.column_stack([times, 80.0 + 0.01 * times])
    growth, slope = soak.growth_mib(leaking)
    assert slope == pytest.approx(36.0)
    assert growth == pytest.approx(0.01 * 3600.0 * (1.0 - soak.WARM_UP) * 0.9, rel=0.02)
    assert growth > soak.FLAT_MIB


@pytest.mark.slow
@pytest.mark.ros
def test_fifteen_seconds_at_full_rate(soak: Any, ros_domain: int) -> None:
    """An hour is for the benchmark; this shows that it works, and what leaks fast."""
    outcome = soak.soak(15.0)
    facts = outcome.facts
    assert facts["sent"] > 13_000
    assert facts["received"] > 0.95 * facts["sent"]  # a loaded machine may lose some, none may be wrong
    wrong = {gate.name: gate.value.value for gate in outcome.gates if "wrong" in gate.name or "order" in gate.name}
    assert wrong == {"samples wrong": 0.0, "samples out of order": 0.0}
    # a process settles for longer than this: the corrector at full rate does not
    assert facts["growth_mib"]["imu_corrector, 1 kHz"] < 0.5
    assert max(facts["growth_mib"].values()) < 4.0
