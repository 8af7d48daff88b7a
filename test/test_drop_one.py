"""Drop-one analysis: what carries each figure, and a source that is wrong is named."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from gyro_calib.cli.main import main
from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation import calibrate
from gyro_calib.estimation.drop_one import DropOne, drop_one
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.report.drop_one_table import drop_one_table
from gyro_calib.simulation import GyroSimulator

RATIO = "drive_gain_ratio_x_over_y"


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    device = draw_unit(load_device("ring_15k"), 1)
    simulator = GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier")
    return run_plan(SimulatedInstrument(simulator), self_calibration_plan(simulator.factory, quality="quick"))


@pytest.fixture(scope="module")
def found(campaign: Campaign) -> DropOne:
    return drop_one(campaign)


def test_every_kind_of_recording_and_every_source_is_left_out_once(found: DropOne) -> None:
    sources = [d.source for d in found.left_out]
    assert len(sources) == len(set(sources))
    assert set(sources) >= {
        "open drive (feedthrough)",
        "body excitation",
        "static records, x oscillator",
        "side bands, y oscillator",
        "side bands at 0.5 Hz",
        "drive-gain ratio of the factory",
        "reciprocity of the stiffness",
    }


def test_figures_are_those_of_the_calibration(campaign: Campaign, found: DropOne) -> None:
    result = calibrate(campaign, with_convergence=False)
    assert found.figures["rate"].value == pytest.approx(result.rate.value)
    assert found.figures["scale_y"].sd == pytest.approx(result.scale_factor["y"].sd)


def test_what_carries_a_figure_is_named_and_nothing_contradicts(found: DropOne) -> None:
    by = {d.source: d for d in found.left_out}
    # r of this unit's scale factor comes from the factory's ratio and from its large cross stiffness
    assert by["drive-gain ratio of the factory"].growth["scale_x"] > 1.1
    assert by["body excitation"].growth["bias_x"] > 1.5
    assert by["static records, x oscillator"].growth["bias_x"] < 2.0
    for figure in found.figures:
        sound = [d.source for d in found.contradicted_by(figure, 4.5)]
        # without open drive E is taken as zero, which is another model, not less data
        assert set(sound) <= {"open drive (feedthrough)"}, figure


def test_recordings_that_are_wrong_are_the_source_that_contradicts(campaign: Campaign, found: DropOne) -> None:
    """The drives of one kind of recording were written 2 permille too large."""
    spoiled = tuple(_louder(r, 2e-3) if r.command.excitation.frequency_hz == 1.5 else r for r in campaign)
    wrong = drop_one(replace(campaign, recordings=spoiled))
    assert "side bands at 1.5 Hz" in [d.source for d in wrong.contradicted_by("scale_x")]
    assert "side bands at 1.5 Hz" not in [d.source for d in found.contradicted_by("scale_x")]
    assert found.misfit_of is None
    assert wrong.misfit_of is not None
    assert wrong.misfit_of.source == "side bands at 1.5 Hz"
    assert wrong.misfit_of.chi2_per_dof < 2.0
    caption = drop_one_table(wrong).caption
    assert "Contradicted: " in caption
    assert "does not fit the side bands at 1.5 Hz" in caption
    # a change that is explained by what was lost is no contradiction, however large: r is known to permilles without the factory's ratio
    assert "drive-gain ratio of the factory" not in [d.source for d in wrong.contradicted_by("scale_x")]


def _louder(recording: Recording, by: float) -> Recording:
    data = recording.data.copy()
    data[:, 6:10] *= 1.0 + by
    return replace(recording, data=data)


def test_a_source_without_which_there_is_no_estimate_says_so(campaign: Campaign) -> None:
    kept = tuple(r for r in campaign if r.command.excitation.kind not in ("drive", "body", "none"))
    one_line = drop_one(replace(campaign, recordings=tuple(r for r in kept if r.command.oscillator_axis)))
    by = {d.source: d for d in one_line.left_out}
    assert "ftr_x" in by["side bands, x oscillator"].refused
    carried = one_line.carried_by("rate")
    assert carried is not None
    assert carried.refused
    with pytest.raises(CalibrationRefused, match="force-rebalance"):
        drop_one(replace(campaign, recordings=()))


def test_command_writes_and_prints_it(campaign: Campaign, tmp_path, capsys) -> None:
    path, out = tmp_path / "unit.h5", tmp_path / "result.json"
    write_campaign_h5(path, campaign)
    assert main(["calibrate", str(path), "--factory-record", "none", "--drop-one", "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Drop-one analysis" in printed
    assert "feedthrough as measured is consistent" in printed
    assert "scale_x is limited by" in printed
    document = json.loads(out.read_text())
    assert set(document["drop_one"]) == {"figures", "chi2_per_dof", "misfit_of", "left_out", "contradictions"}
    assert {"left_out", "change", "sd_growth", "chi2_per_dof", "refused"} == set(document["drop_one"]["left_out"][0])
