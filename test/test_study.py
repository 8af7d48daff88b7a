"""The study framework: same figures whatever the number of processes, gates that fail when they must, failures that are told."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from study_samples import FAILING, INCONSISTENT, NOISE

from gyro_calib import study as framework
from gyro_calib.cli import study as command
from gyro_calib.cli.main import main
from gyro_calib.errors import DataError
from gyro_calib.quantity import Quantity
from gyro_calib.study import Gate, Study, coverage, find_study, list_studies, quantile, rms, run_study


def test_processes_do_not_change_the_figures():
    alone = run_study(NOISE, range(6))
    together = run_study(NOISE, [5, 4, 3, 2, 1, 0], jobs=2)
    assert alone.seeds == (0, 1, 2, 3, 4, 5)
    assert together.seeds == (5, 4, 3, 2, 1, 0)
    assert together.figures["error [deg/h]"][::-1].tolist() == alone.figures["error [deg/h]"].tolist()
    assert alone.figures["error [deg/h]"][2] == np.random.default_rng(2).standard_normal()
    assert len(set(alone.figures["pid"])) == 1
    assert set(alone.figures["pid"]).isdisjoint(together.figures["pid"])


def test_progress_counts_every_seed():
    seen = []
    run_study(NOISE, range(4), on_done=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_a_failed_seed_fails_the_study_but_keeps_the_rest():
    result = run_study(FAILING, range(5))
    assert result.seeds == (0, 1, 2, 4)
    assert result.failures == {3: "DataError: Seed must not be 3, but got 3."}
    assert [gate.name for gate in result.gates if not gate.passed] == ["seeds that failed"]
    assert not result.passed


def test_json_is_standard_and_complete():
    document = json.loads(json.dumps(run_study(FAILING, range(5)).to_json(), allow_nan=False))
    assert document["seeds"] == [0, 1, 2, 4]
    assert document["failures"]["3"].startswith("DataError")
    assert document["passed"] is False
    assert document["gates"][0]["value"]["unit"] == "deg/h"
    assert document["gates"][0]["upper"] == 1.5
    assert document["gates"][0]["lower"] is None
    assert {"gyro_calib", "python", "numpy", "scipy", "numba"} <= set(document["versions"])
    assert len(document["figures"]["error [deg/h]"]) == 4


@pytest.mark.parametrize(
    ("study", "options", "message"),
    [
        (NOISE, {"seeds": []}, "one or more seeds, but got none"),
        (NOISE, {"seeds": [1], "jobs": 0}, "jobs must be >= 1, but got 0"),
        (FAILING, {"seeds": [3]}, "must succeed for some seed"),
        (INCONSISTENT, {"seeds": [0, 1]}, "must return name 0 for every seed, but got name 1 for seed 1"),
    ],
)
def test_refusals(study, options, message):
    with pytest.raises(DataError, match=message):
        run_study(study, **options)


@pytest.mark.parametrize(
    ("value", "limits", "passed", "text"),
    [
        (1.0, {"upper": 1.0}, True, "≤ 1"),
        (1.1, {"upper": 1.0}, False, "≤ 1"),
        (0.9, {"lower": 1.0}, False, "≥ 1"),
        (0.9, {"lower": 0.8, "upper": 1.3}, True, "0.8 … 1.3"),
        (math.nan, {"upper": 1.0}, False, "≤ 1"),
        (math.nan, {}, True, ""),
    ],
)
def test_gates(value, limits, passed, text):
    gate = Gate("g", Quantity(value, 0.0, "1"), **limits)
    assert gate.passed is passed
    assert gate.limit == text


def test_statistics_know_their_own_uncertainty():
    rng = np.random.default_rng(0)
    repeated = [rms(rng.standard_normal(50), "1") for _ in range(400)]
    scatter = np.std([q.value for q in repeated])
    assert np.mean([q.sd for q in repeated]) == pytest.approx(scatter, rel=0.15)
    repeated = [quantile(rng.standard_normal(200), 0.5, "1") for _ in range(400)]
    assert np.mean([q.sd for q in repeated]) == pytest.approx(np.std([q.value for q in repeated]), rel=0.2)
    inside = coverage([0.1, 1.9, -1.9, 2.1], np.ones(4))
    assert inside.value == 75.0
    repeated = [coverage(rng.standard_normal(100), np.ones(100)) for _ in range(400)]
    assert np.mean([q.sd for q in repeated]) == pytest.approx(np.std([q.value for q in repeated]), rel=0.35)


def test_registry_finds_what_it_lists():
    names = [study.name for study in list_studies()]
    assert names == sorted(set(names))
    for name in names:
        assert find_study(name).name == name
    with pytest.raises(DataError, match=r"Study must be one of .*, but got 'nonsense'"):
        find_study("nonsense")


@pytest.fixture
def known_studies(monkeypatch):
    """The command sees the sample studies."""
    known = {study.name: study for study in (NOISE, FAILING)}
    monkeypatch.setattr(framework, "find_study", known.__getitem__)
    monkeypatch.setattr(framework, "list_studies", lambda: list(known.values()))


@pytest.mark.usefixtures("known_studies")
def test_command_lists_runs_and_writes(tmp_path, capsys):
    assert main(["study", "--list"]) == 0
    listed = capsys.readouterr().out
    assert "noise" in listed
    assert "A unit normal." in listed
    plot, document = tmp_path / "plot.svg", tmp_path / "study.json"
    assert main(["study", "noise", "--seeds", "6", "--jobs", "1", "--json", str(document), "--plot", str(plot)]) == 0
    out = capsys.readouterr().out
    assert "rms error" in out
    assert "pass" in out
    assert json.loads(document.read_text())["seeds"] == [0, 1, 2, 3, 4, 5]
    assert plot.stat().st_size > 1000


@pytest.mark.usefixtures("known_studies")
def test_command_says_that_a_gate_failed(capsys):
    assert main(["study", "failing", "--seeds", "5", "--jobs", "1"]) == 1
    captured = capsys.readouterr()
    assert "FAIL" in captured.out
    assert "seed 3 failed: DataError: Seed must not be 3, but got 3." in captured.err


def test_own_plot_of_a_study_is_used():
    drawn = []
    study = Study("s", "d", NOISE.run, NOISE.summarise, plot=lambda figures, theme: drawn.append(sorted(figures)))
    command.study_drawing(run_study(study, range(2)))
    assert drawn == [["error [deg/h]", "pid"]]


@pytest.mark.parametrize("arguments", [[], ["noise", "--list"], ["noise", "--seeds", "0"], ["noise", "--jobs", "x"]])
def test_usage(arguments, capsys):
    assert main(["study", *arguments]) == 2
    assert "usage: gyro-calib study" in capsys.readouterr().err
