"""A fleet of healthy units: how large their coefficients are, and what a diagnosis sees beside that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import norm

from gyro_calib.cli.main import main
from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import diagnose
from gyro_calib.gap.fleet import Coefficients, FleetSize, _evidence, fleet_sizes, fleet_spread
from gyro_calib.gap.fleet_file import read_fleet, write_fleet
from gyro_calib.gap.healthy import _SIZE_OF, HealthySpread
from gyro_calib.gap.units import Unit, fleet_of, units_of_files
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator

USUAL = HealthySpread()
#: gains of both drives and both pick-offs, of which loops tell the products of an axis alone
GAINS = ("thermal_drive_gain.g_x", "thermal_drive_gain.g_y", "thermal_pickoff_gain.g_x", "thermal_pickoff_gain.g_y")


def told_unit(size: float, rng: np.random.Generator, sd: float = 0.01, damping: float = 0.4) -> Coefficients:
    """A unit whose gains are of a size, over the usual one: sums of drive and pick-off measured to ``sd``, nothing else told of them."""
    truth = np.array([*(size * rng.standard_normal(4)), damping * rng.standard_normal()])
    design = np.array([[1.0, 0, 1, 0, 0], [0, 1, 0, 1, 0], [0, 0, 0, 0, 1]]) / sd
    seen = design @ truth + rng.standard_normal(3)
    sizes = ("axis_gain_per_k",) * 4 + ("damping_per_k",)
    return Coefficients((*GAINS, "thermal_damping.c"), sizes, design.T @ design, design.T @ seen)


# -- the evidence of a size ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.05, 0.4, 2.0])
def test_evidence_of_a_size_is_the_integral_over_the_coefficients(size: float) -> None:
    """Closed form against quadrature: likelihood = posterior over prior, times the other prior."""
    precision, likeliest = np.array([[4.0, 1.5], [1.5, 6.0]]), np.array([0.35, -0.1])
    unit = Coefficients(("a", "b"), ("gain_per_k",) * 2, precision, precision @ likeliest)

    def integrand(y: float, x: float) -> float:
        away = np.array([x, y]) - likeliest
        return math.exp(-0.5 * away @ precision @ away) * norm.pdf(x, 0.0, size) * norm.pdf(y, 0.0, size)

    reach = min(8.0 * size, 6.0)
    integral, _ = dblquad(integrand, -reach, reach, -reach, reach)
    # over the likelihood of nothing
    at_zero = math.exp(-0.5 * likeliest @ precision @ likeliest)
    found, _ = _evidence(unit, np.full(2, size))
    assert found == pytest.approx(math.log(integral / at_zero), abs=1e-5)


def test_its_slopes_are_those_of_differences() -> None:
    unit, sd, step = told_unit(0.3, np.random.default_rng(9)), np.array([0.2, 0.5, 0.1, 0.3, 0.7]), 1e-5
    _, slopes = _evidence(unit, sd)
    for k in range(5):
        up, down = (_evidence(unit, sd * np.exp(s * step * (np.arange(5) == k)))[0] for s in (1.0, -1.0))
        assert slopes[k] == pytest.approx((up - down) / (2.0 * step), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("size", [0.03, 0.3])
def test_bounds_are_kept_by_nineteen_of_twenty_fleets(size: float) -> None:
    rng = np.random.default_rng(7)
    kept, found = 0, []
    for _ in range(40):
        sizes = {s.name: s for s in fleet_sizes([told_unit(size, rng) for _ in range(5)])}
        gain = sizes["axis_gain_per_k"]
        kept += gain.bound > size * gain.usual
        found.append(gain.bound / gain.usual)
        assert gain.likeliest <= gain.bound
    # binomial: 34 of 40 or fewer at 0.95 happens once in 70
    assert kept >= 35
    # and says something: ten sums of five units
    assert size < np.median(found) < 2.0 * size


def test_what_only_sums_tell_is_told_of_the_parts() -> None:
    """Each part by itself has half of its prior as a posterior, whatever the sums are; marginals would call that the size."""
    rng = np.random.default_rng(1)
    units = [told_unit(0.02, rng) for _ in range(6)]
    assert all(0.6 < math.sqrt(np.linalg.inv(np.eye(5) + unit.precision)[0, 0]) < 0.8 for unit in units)
    (gain, _) = fleet_sizes(units)
    assert gain.is_told
    assert gain.bound < 0.05 * gain.usual


def test_what_no_unit_tells_is_as_of_any_device() -> None:
    rng = np.random.default_rng(2)
    units = [told_unit(0.5, rng, sd=100.0, damping=0.0) for _ in range(4)]
    sizes = fleet_sizes(units)
    assert not any(s.is_told for s in sizes)
    assert fleet_spread(sizes) == USUAL


def test_a_fleet_may_be_less_alike_than_any_device_is_believed_to_be() -> None:
    rng = np.random.default_rng(3)
    (gain, _) = fleet_sizes([told_unit(3.0, rng) for _ in range(6)])
    assert gain.is_told
    assert gain.bound > gain.likeliest > 1.5 * gain.usual


def test_two_units_are_no_fleet_and_a_fleet_without_a_temperature_run_says_nothing() -> None:
    rng = np.random.default_rng(4)
    with pytest.raises(DataError, match="3 units or more, but got 2"):
        fleet_sizes([told_unit(0.1, rng) for _ in range(2)])
    nothing = Coefficients((), (), np.zeros((0, 0)), np.zeros(0))
    with pytest.raises(DataError, match="temperature moves"):
        fleet_sizes([nothing] * 3)


# -- the sizes and their file -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.0, -1e-5, math.nan, math.inf, True, "1e-5"])
def test_sizes_are_positive(size: object) -> None:
    with pytest.raises(ValueError, match="axis_gain_per_k must be a positive size"):
        HealthySpread(axis_gain_per_k=size)  # type: ignore[arg-type]


def test_every_size_is_that_of_a_column() -> None:
    assert set(_SIZE_OF.values()) == set(HealthySpread.__dataclass_fields__)


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    sizes = fleet_sizes([told_unit(0.05, rng) for _ in range(4)])
    written = write_fleet(tmp_path / "new" / "fleet.yaml", 15000.0, ["r'1", "r 2", "r:3", "4"], sizes)
    read = read_fleet(tmp_path / "new" / "fleet.yaml")
    assert read.units == written.units == ("r'1", "r 2", "r:3", "4")
    assert read.healthy.axis_gain_per_k == pytest.approx(written.healthy.axis_gain_per_k, rel=5e-3)
    assert read.healthy.phase_per_k == USUAL.phase_per_k
    read.check_kind({"nominal_f0_hz": 16000.0})
    with pytest.raises(DataError, match=r"about 15000 Hz, but got 5300 Hz\. Give --fleet the file of this kind"):
        read.check_kind({"nominal_f0_hz": 5300.0})


@pytest.mark.parametrize("bound", [2e-6, 1.2345e-5, 1.0])
def test_sizes_of_any_digits_are_numbers_to_who_reads_them(tmp_path: Path, bound: float) -> None:
    """2e-06 is a text to YAML; by hand it is written so all the same."""
    write_fleet(tmp_path / "f.yaml", 15000.0, ["a"], [FleetSize("split_axis_per_k", 0.5 * bound, bound, 1e-3)])
    assert read_fleet(tmp_path / "f.yaml").healthy.split_axis_per_k == pytest.approx(bound, rel=5e-3)
    (tmp_path / "f.yaml").write_text("healthy: {gain_per_k: 1e-5}\nnominal_f0_hz: 1e4")
    assert read_fleet(tmp_path / "f.yaml").healthy.gain_per_k == 1e-5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("healthy: {gain_per_kelvin: 1e-5}\nnominal_f0_hz: 1e4", "no size of a healthy device is called gain_per_kelvin"),
        ("healthy: {gain_per_k: -1e-5}\nnominal_f0_hz: 1.0e4", "gain_per_k must be a positive size"),
        ("healthy: {gain_per_k: 1.0e-5}", "nominal_f0_hz > 0"),
        ("gain_per_k: 1.0e-5", "a part `healthy`"),
        ("healthy: [", "but got"),
        ("healthy: {}\nnominal_f0_hz: 1.0e4\nunits: 5", "units must be a list"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "f.yaml").write_text(text)
    with pytest.raises(DataError, match=r"healthy|nominal|units") as caught:
        read_fleet(tmp_path / "f.yaml")
    assert said in str(caught.value)


# -- the command --------------------------------------------------------------------------------------------------------------------------


def unit(name: str, verdict: str = "none", effects: Sequence[str] = (), f0: float = 15000.0, seed: int = 0) -> Unit:
    return Unit(name, f0, verdict, tuple(effects), told_unit(0.05, np.random.default_rng(seed)))


def test_units_that_are_not_healthy_are_left_out() -> None:
    units = [unit("a"), unit("b", "effects"), unit("c", "effects", ["duffing"]), unit("d", "unknown"), unit("e")]
    healthy, warnings = fleet_of(units)
    assert [u.device_id for u in healthy] == ["a", "b", "e"]
    assert warnings == ["c is left out: its verdict is effects (duffing).", "d is left out: its verdict is unknown."]


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ([unit("a"), unit("b"), unit("c", f0=5000.0)], "a of 15000 Hz and c of 5000 Hz"),
        ([unit("a"), unit("b"), unit("a")], "got a twice"),
        ([unit("a"), unit("b"), unit("c", "unknown")], "got 2, and not c"),
    ],
)
def test_what_is_no_fleet_is_refused(units: list[Unit], said: str) -> None:
    with pytest.raises(DataError, match=said):
        fleet_of(units)


def test_the_command_writes_what_a_diagnosis_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def diagnosed(campaign: Campaign) -> Unit:
        name = campaign.device_id
        return unit(name, "unknown" if name == "d" else "none", seed=ord(name))

    monkeypatch.setattr("gyro_calib.gap.units.load_campaign", lambda path, topic=None: Campaign(path.stem, (), {}))
    monkeypatch.setattr("gyro_calib.gap.units.unit_of", diagnosed)
    out = tmp_path / "fleet.yaml"
    assert main(["fleet", *(f"{name}.h5" for name in "abcd"), "--yaml", str(out)]) == 0
    said = capsys.readouterr()
    assert "axis_gain_per_k" in said.out
    assert "warning: d is left out" in said.err
    assert read_fleet(out).healthy.axis_gain_per_k < 0.3 * USUAL.axis_gain_per_k
    out.write_text("healthy: {}\nnominal_f0_hz: 1\n")
    assert main(["fleet", "a.h5", "d.h5", "--yaml", str(out)]) == 1
    assert "3 healthy units or more" in capsys.readouterr().err
    assert out.read_text().startswith("healthy: {}"), "what was there stays"


def test_what_a_process_of_its_own_refuses_is_said_as_by_one(tmp_path: Path) -> None:
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for path in paths:
        path.write_text("no recording")
    with pytest.raises(DataError, match=r"[ab]\.h5"):
        units_of_files(paths, jobs=2, on_done=pytest.fail)


# -- what a diagnosis sees beside a fleet -------------------------------------------------------------------------------------------------


def recorded(seed: int, effects: dict[str, dict[str, float]] | None = None) -> Campaign:
    """A ring with its temperature run, slow flow."""
    device = replace(draw_unit(load_device("ring_15k"), seed), effects=effects or {})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(seed), fidelity="slow_flow"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=("temperature",)))


@pytest.mark.slow
def test_a_gain_as_any_device_may_have_it_is_an_effect_of_one_of_a_fleet() -> None:
    """2.5e-4/K of one drive (a 28th plant: read right, and worth 5 in chi-square)."""
    units = [diagnose(recorded(seed)) for seed in (11, 12, 13)]
    assert [u.verdict for u in units] == ["none"] * 3
    coefficients = [u.estimate.coefficients for u in units if u.estimate is not None]
    spread = fleet_spread(fleet_sizes([c for c in coefficients if c is not None]))
    assert spread.axis_gain_per_k < 0.2 * USUAL.axis_gain_per_k
    gained = recorded(14, {"thermal_drive_gain": {"g_x": 0.0, "g_y": 1.2e-4}})
    assert diagnose(gained).verdict == "none"
    found = diagnose(gained, healthy=spread)
    assert [e.name for e in found.effects] == ["thermal_drive_gain"]
    size = found.effects[0].parameters["g_y"]
    assert abs(size.value - 1.2e-4) < 3.0 * size.sd
    assert found.effects[0].gain > 30.0
    # and one that is as its fleet is stays healthy
    assert diagnose(recorded(15), healthy=spread).verdict == "none"


@pytest.mark.slow
def test_two_processes_tell_what_one_tells(tmp_path: Path) -> None:
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for path, seed in zip(paths, (12, 13), strict=True):
        write_campaign_h5(path, recorded(seed))
    one, two = (units_of_files(paths, jobs=jobs, on_done=str) for jobs in (1, 2))
    assert [u.device_id for u in two] == [u.device_id for u in one]
    for a, b in zip(one, two, strict=True):
        assert (a.verdict, a.effects, a.coefficients.names) == (b.verdict, b.effects, b.coefficients.names)
        np.testing.assert_allclose(a.coefficients.information, b.coefficients.information, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_coefficients_are_over_the_usual_sizes_whatever_stood_in_the_fit() -> None:
    campaign = recorded(11)
    by_default, told = diagnose(campaign), diagnose(campaign, healthy=replace(USUAL, damping_per_k=1e-2))
    assert by_default.estimate is not None
    assert told.estimate is not None
    one, other = by_default.estimate.coefficients, told.estimate.coefficients
    assert one is not None
    assert other is not None
    assert one.names == other.names
    k = one.names.index("thermal_damping.c")
    # of a known coefficient, alike; of the usual size in units of one
    assert other.precision[k, k] == pytest.approx(one.precision[k, k], rel=0.05)
    assert other.information[k] == pytest.approx(one.information[k], rel=0.05)
    # drifts, which have their own size in a fit, over the largest that they may have
    k = one.names.index("drift.gain.x.1")
    assert one.precision[k, k] > 1.0
