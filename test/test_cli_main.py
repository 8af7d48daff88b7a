"""The command line without ROS: exit codes, files, JSON contracts, help at once."""

from __future__ import annotations

import importlib.util
import json
import math
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_data import BENCH, needs_bench

from gyro_calib.cli.main import build_parser, main
from gyro_calib.units import DEG_H


def run(*arguments):
    return main([str(argument) for argument in arguments])


def is_quantity(entry):
    return set(entry) == {"value", "sd", "unit"} and isinstance(entry["unit"], str)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A short self-calibration, simulated by the command itself."""
    folder = tmp_path_factory.mktemp("recordings")
    arguments = ("--plan", "self_calibrate", "--seed", "3", "--rate", "40", "--quality", "quick", "--fidelity", "slow_flow")
    assert run("simulate", "ring_15k", *arguments, "--out", folder) == 0
    (path,) = folder.iterdir()
    return path


def test_help_names_every_command_and_loads_nothing_heavy():
    code = (
        "import sys; from gyro_calib.cli.main import main; code = main(['--help'])\n"
        "heavy = {'numpy', 'scipy', 'rich', 'matplotlib', 'h5py', 'rclpy', 'yaml'} & set(sys.modules)\n"
        "assert not heavy, heavy\nsys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for command in ("demo", "up", "call", "simulate", "calibrate", "diagnose", "compare", "allan", "study"):
        assert re.search(rf"\n    {command}\s", done.stdout)


@pytest.mark.parametrize("command", ["demo", "up", "call", "simulate", "calibrate", "diagnose", "compare", "allan", "study"])
def test_every_command_has_help(command, capsys):
    assert run(command, "--help") == 0
    out = capsys.readouterr().out
    assert "default: None" not in out
    assert "default: False" not in out
    assert out.startswith(f"usage: gyro-calib {command}")


@pytest.mark.parametrize("arguments", [(), ("nonsense",), ("simulate", "ring_15k"), ("calibrate",), ("demo", "--seed", "-1")])
def test_usage_errors_exit_2(arguments, capsys):
    assert run(*arguments) == 2
    assert "usage: gyro-calib" in capsys.readouterr().err


def test_interrupt_exits_130(monkeypatch, capsys):
    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("gyro_calib.device.load_device", interrupted)
    assert run("simulate", "ring_15k", "--plan", "static", "--out", "unused") == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_simulate_refuses_what_does_not_exist_and_what_does(recording, capsys):
    assert run("simulate", "no_such_device", "--plan", "static", "--out", recording.parent) == 1
    assert "Device must be" in capsys.readouterr().err
    assert run("simulate", "ring_15k", "--plan", "nonsense", "--out", recording.parent) == 1
    assert "Plan must be one of" in capsys.readouterr().err
    before = recording.read_bytes()
    again = ("--plan", "self_calibrate", "--out", recording.parent, "--seed", "3", "--quality", "quick")
    assert run("simulate", "ring_15k", *again) == 1
    assert "must be new" in capsys.readouterr().err
    assert recording.read_bytes() == before


def test_simulate_then_calibrate(recording, tmp_path, capsys):
    """The estimate of the command against the rate that the command was told to simulate."""
    document, page = tmp_path / "result.json", tmp_path / "page.html"
    assert run("calibrate", recording, "--json", document, "--html", page) == 0
    captured = capsys.readouterr()
    assert "constant input rate" in captured.out
    assert "angular_gain_kappa" in captured.err
    found = json.loads(document.read_text())
    assert found["device_id"] in recording.name
    for key in ("device_id", "method", "rate", "bias", "scale_factor", "parameters", "condition_number", "not_observable", "warnings"):
        assert key in found
    assert is_quantity(found["rate"])
    assert all(is_quantity(entry) for group in ("bias", "scale_factor", "parameters") for entry in found[group].values())
    assert set(found["bias"]) == set(found["scale_factor"]) == {"x", "y"}
    error = found["rate"]["value"] / DEG_H - 40.0
    assert abs(error) < 5.0 * found["rate"]["sd"] / DEG_H
    assert found["rate"]["sd"] / DEG_H < 20.0
    text = page.read_text(encoding="utf-8")
    assert f"Calibration of {found['device_id']}" in text
    assert text.count("<svg") >= 4


def test_json_on_stdout_is_only_json(recording, capsys):
    assert run("calibrate", recording, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["method"] == "sideband"


def test_calibrate_says_why_it_cannot(tmp_path, capsys):
    assert run("calibrate", tmp_path / "absent.h5") == 1
    assert "Recording must exist" in capsys.readouterr().err
    (tmp_path / "text.h5").write_text("not a recording")
    assert run("calibrate", tmp_path / "text.h5") == 1
    assert capsys.readouterr().err.startswith("gyro-calib calibrate: ")


def test_json_file_that_cannot_be_written(recording, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run("calibrate", recording, "--json", tmp_path / "file" / "result.json") == 1
    assert "Output --json must be writable" in capsys.readouterr().err


def test_bag_gives_the_same_result(tmp_path, capsys):
    pytest.importorskip("rosbags")
    results = []
    for kind in ("h5", "mcap"):
        options = ("--plan", "sideband", "--seed", "5", "--quality", "quick", "--fidelity", "slow_flow", "--format", kind)
        assert run("simulate", "ring_15k", *options, "--out", tmp_path / kind) == 0
        (path,) = (tmp_path / kind).iterdir()
        assert run("calibrate", path, "--json", tmp_path / f"{kind}.json") == 0
        results.append(json.loads((tmp_path / f"{kind}.json").read_text()))
    capsys.readouterr()
    assert results[0]["rate"]["value"] == pytest.approx(results[1]["rate"]["value"], rel=1e-6)
    assert results[0]["bias"]["x"]["value"] == pytest.approx(results[1]["bias"]["x"]["value"], rel=1e-6)


def test_allan_of_a_text_file(tmp_path, capsys):
    """White noise of 0.05 deg/sqrt(h) at 20 Hz, in deg/h, second column."""
    rng = np.random.default_rng(7)
    rate = 0.05 * 60.0 * math.sqrt(20.0) * rng.standard_normal(4000)
    path = tmp_path / "rate.csv"
    path.write_text("# t, rate\n" + "\n".join(f"{k / 20},{value:.9g}" for k, value in enumerate(rate)))
    document, plot = tmp_path / "allan.json", tmp_path / "allan.png"
    page = tmp_path / "allan.html"
    options = ("--rate-hz", "20", "--unit", "deg/h", "--column", "1", "--json", document, "--plot", plot, "--html", page)
    assert run("allan", path, *options) == 0
    assert "angle random walk" in capsys.readouterr().out
    found = json.loads(document.read_text())
    walk = found["coefficients"]["angle_random_walk"]
    assert is_quantity(walk)
    assert math.degrees(walk["value"]) * 60.0 == pytest.approx(0.05, abs=4.0 * math.degrees(walk["sd"]) * 60.0)
    assert walk["sd"] < 0.1 * walk["value"]
    assert "rate_random_walk" in found["not_observable"]
    assert found["duration_s"] == 200.0
    assert len(found["curve"]["tau_s"]) == len(found["curve"]["edf"])
    assert plot.stat().st_size > 1000
    assert page.read_text().count("<svg") == 2


def test_allan_of_a_recording(recording, capsys):
    assert run("allan", recording) == 0
    assert "static_x_0" in capsys.readouterr().out
    assert run("allan", recording, "--label", "nonsense") == 1
    assert "labelled 'nonsense'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("1\n2\n", (), "--rate-hz must be given"),
        ("1\nx\n", ("--rate-hz", "1"), "must hold numbers in columns"),
        ("1\n2\n", ("--rate-hz", "1", "--column", "4"), "column must be below 1, but got 4"),
        ("1\n2\n", ("--rate-hz", "1"), "16 or more samples"),
    ],
)
def test_allan_refuses(text, options, message, tmp_path, capsys):
    (tmp_path / "rate.txt").write_text(text)
    assert run("allan", tmp_path / "rate.txt", *options) == 1
    assert message in capsys.readouterr().err


@needs_bench
def test_recordings_of_a_stranger_need_a_scale_factor_for_allan(capsys):
    assert run("allan", BENCH / "ring_a.h5") == 1
    assert "Give --scale-factor" in capsys.readouterr().err
    assert run("allan", BENCH / "ring_a.h5", "--scale-factor", "0.0937") == 0
    assert "static_x" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [("allan", "x.txt", "--rate-hz", "1"), ("study", "any"), ("calibrate", "x.h5")])
def test_what_cannot_be_drawn_is_said_before_the_work(arguments, monkeypatch, capsys):
    monkeypatch.setattr("gyro_calib.study.find_study", lambda name: name)
    option, name = ("--html", "page.html") if arguments[0] == "calibrate" else ("--plot", "plot.png")
    if option == "--plot":
        assert run(*arguments, option, "plot.xyz") == 1
        assert "must end in .pdf, .png, .svg" in capsys.readouterr().err
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda wanted, *rest: None if wanted == "matplotlib" else find(wanted, *rest))
    assert run(*arguments, option, name) == 1
    assert "pip install 'gyro_calib[viz]'" in capsys.readouterr().err


def readme():
    return (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


def test_commands_of_the_readme_parse():
    lines = re.findall(r"^(?:gyro-calib) (.*)$", readme(), flags=re.MULTILINE)
    assert len(lines) >= 6
    for line in lines:
        assert build_parser().parse_args(shlex.split(line, comments=True)).run


def test_python_of_the_readme_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", readme(), flags=re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    rate, sd, truth = map(float, re.fullmatch(r"rate (\S+) ± (\S+) deg/h, truly (\S+)\n", capsys.readouterr().out).groups())
    assert abs(rate - truth) < 6.0 * sd + 0.1
    assert sd < 10.0


def test_parser_runs_the_command_it_names():
    assert build_parser().parse_args(["study", "--list"]).run.__module__ == "gyro_calib.cli.study"
