"""``gyro-calib diagnose``: JSON contract, terminal, page, exit codes; and the practice recordings of another plant."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from bench_data import BENCH, needs_bench

from gyro_calib.cli.main import build_parser, main
from gyro_calib.cli.simulate import _device as _simulated_device
from gyro_calib.device import draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import Diagnosis, FoundEffect, Gap, NextExperiment, Standing, Unknown, diagnose
from gyro_calib.gap.diagnosis import Alternative
from gyro_calib.gap.gap_map import Cell
from gyro_calib.paths import package_version
from gyro_calib.quantity import Quantity
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.report.gap_page import gap_page
from gyro_calib.report.gap_tables import effects_table, status_words
from gyro_calib.report.page import render_page
from gyro_calib.simulation import GyroSimulator

STEPS = ("static_", "side_", "locate", "feed_x_+20hz", "feed_y_+20hz")
VERDICTS = ("none", "effects", "unknown", "not_testable")


def is_quantity(entry):
    return set(entry) == {"value", "sd", "unit"} and isinstance(entry["unit"], str)


# -- one small campaign through the command -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    """A small campaign of a ring whose drives are not linear."""
    unit = replace(draw_unit(load_device("ring_15k"), 11), effects={"duffing_axes": {"k_x": 0.03, "k_y": -0.02}})
    plan = gap_ftr_plan(unit.factory(), quality="quick")
    plan = replace(plan, steps=tuple(s for s in plan.steps if s.label.startswith(STEPS)))
    simulator = GyroSimulator(unit, rng=np.random.default_rng(5), fidelity="slow_flow")
    campaign = run_plan(SimulatedInstrument(simulator, 1e-4), plan)
    return write_campaign_h5(tmp_path_factory.mktemp("gap") / "ring.h5", campaign)


@pytest.fixture(scope="session")
def written(recording):
    """JSON document and page of the command, and the diagnosis that it made."""
    files, made = {name: recording.parent / name for name in ("gap.json", "gap.html")}, []

    def kept(*campaign, **options):
        made.append(diagnose(*campaign, **options))
        return made[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gyro_calib.gap.diagnose", kept)
        assert main(["diagnose", str(recording), "--json", str(files["gap.json"]), "--html", str(files["gap.html"])]) == 0
    return json.loads(files["gap.json"].read_text()), files["gap.html"].read_text(), made[0]


@pytest.fixture(scope="session")
def outputs(written):
    """JSON document and page."""
    return written[:2]


@pytest.fixture
def diagnosed(written, monkeypatch):
    """The command with that diagnosis: what it writes and prints is asked, not what it finds."""
    monkeypatch.setattr("gyro_calib.gap.diagnose", lambda campaign, **options: written[2])


def test_a_verdict_beside_a_fleet_says_so(diagnosed, recording, tmp_path, capsys):
    fleet, page, document = (tmp_path / name for name in ("fleet.yaml", "gap.html", "gap.json"))
    fleet.write_text("nominal_f0_hz: 15000.0\nhealthy: {axis_gain_per_k: 2.0e-6}\n")
    assert main(["diagnose", str(recording), "--fleet", str(fleet), "--json", str(document), "--html", str(page)]) == 0
    assert "judged beside the fleet of fleet.yaml" in capsys.readouterr().out
    assert "judged beside the fleet of fleet.yaml" in page.read_text()
    assert json.loads(document.read_text())["provenance"]["fleet"]["sha256"] == hashlib.sha256(fleet.read_bytes()).hexdigest()
    fleet.write_text("nominal_f0_hz: 5300.0\nhealthy: {}\n")
    assert main(["diagnose", str(recording), "--fleet", str(fleet)]) == 1
    assert "but got 15000 Hz" in capsys.readouterr().err


def test_json_has_the_keys_of_the_contract(outputs):
    document, _ = outputs
    assert {"verdict", "effects", "unknown", "map", "gap", "not_testable", "next_experiment"} <= set(document)
    assert document["verdict"] in VERDICTS
    assert document["effects"], "the campaign holds an effect"
    for effect in document["effects"]:
        assert {"name", "group", "probability", "parameters", "location"} <= set(effect)
        assert effect["name"] in effect["group"]
        assert 0.0 <= effect["probability"] <= 1.0
        assert effect["parameters"]
        assert all(map(is_quantity, effect["parameters"].values()))
    assert document["map"]
    assert all({"experiment", "channel", "quadrature", "feature", "share", "z"} <= set(cell) for cell in document["map"])
    gap = document["gap"]
    assert gap["before"]["rms_over_noise"] > gap["after"]["rms_over_noise"] > 0.0
    assert is_quantity(gap["closed_fraction"])
    assert all(is_quantity(gap[name][when]) for name in ("bias", "scale_factor") for when in ("before", "after"))


def test_json_says_what_was_read_and_by_what(outputs, recording):
    provenance = outputs[0]["provenance"]
    assert provenance["package_version"] == package_version()
    assert provenance["inputs"] == [{"name": "ring.h5", "sha256": hashlib.sha256(recording.read_bytes()).hexdigest()}]


def test_the_effect_is_named_with_its_size(outputs):
    (effect,) = outputs[0]["effects"]
    assert "duffing" in effect["group"]
    assert effect["registry_name"] == "duffing_axes"
    # how far the claimed sd may be believed is for the blind trials to say
    assert effect["parameters"]["k_x"]["value"] == pytest.approx(0.03, rel=0.05)
    assert effect["parameters"]["k_y"]["value"] == pytest.approx(-0.02, rel=0.05)


def test_the_page_stands_alone(outputs):
    _, page = outputs
    assert "duffing" in page
    assert not re.search(r'(src|href)="(?!#)', page.replace("xlink:", ""))
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", page)
    assert page.count("<svg") == len(re.findall(r"<figcaption>[^<]{20,}", page)) >= 2
    for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ElementTree.fromstring(svg)


def test_a_person_reads_the_verdict(recording, diagnosed, capsys):
    assert main(["diagnose", str(recording), "--all"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("ring_15k-0011, ")
    for words in (
        "duffing",
        "Where the gap lies",
        "times its noise",
        "Before and after",
        "deg/h",
        "ppm",
        "Next experiment:",
        "excluded above",
    ):
        assert words in out


def test_json_on_stdout_is_all_there_is(recording, diagnosed, capsys):
    assert main(["diagnose", str(recording), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "effects"


def test_json_is_written_though_the_terminal_is_gone(recording, diagnosed, tmp_path, monkeypatch):
    def gone(*arguments, **options):
        raise BrokenPipeError

    monkeypatch.setattr("gyro_calib.cli.diagnose.print_diagnosis", gone)
    arguments = build_parser().parse_args(["diagnose", str(recording), "--json", str(tmp_path / "gap.json")])
    with pytest.raises(BrokenPipeError):
        arguments.run(arguments)
    assert json.loads((tmp_path / "gap.json").read_text())["verdict"] == "effects"


def test_json_words_an_effect_as_the_simulator_takes_it(outputs):
    """Per axis the parameters are those of a variant with a name of its own."""
    (effect,) = outputs[0]["effects"]
    arguments = build_parser().parse_args(["simulate", "ring_15k", "--plan", "static", "--steps", *_options(effect["simulate"])])
    effects = _simulated_device(arguments).effects
    assert effects == {"duffing_axes": {name: effect["parameters"][name]["value"] for name in ("k_x", "k_y")}}


def _options(sizes):
    return [word for size in sizes for word in ("--effect", size)]


def test_sizes_for_the_simulator_keep_to_what_it_takes():
    sizes = {"c_x": Quantity(-0.001, 0.01, "V/s"), "c_y": Quantity(0.5, 0.01, "V/s"), "share": Quantity(1.0, 0.1, "1")}
    found = FoundEffect("coulomb_friction", "", ("coulomb_friction",), 0.9, sizes, "dynamics", "coulomb_friction_axes", 300.0)
    least = EFFECTS["coulomb_friction_axes"].parameter("c_x").lower
    assert found.to_json()["simulate"] == [f"coulomb_friction_axes.c_x={least!r}", "coulomb_friction_axes.c_y=0.5"]


@pytest.mark.parametrize("option", ["--html", "--json", "--patched-device"])
def test_an_output_that_cannot_be_written_is_said_before_the_diagnosis(recording, tmp_path, monkeypatch, capsys, option):
    monkeypatch.setattr("gyro_calib.gap.diagnose", lambda *arguments, **options: pytest.fail("diagnosed"))
    (tmp_path / "file").write_text("")
    target = tmp_path / "file" / "out"
    assert main(["diagnose", str(recording), "--device", "ring_15k", option, str(target)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"gyro-calib diagnose: Output {option} must be writable, but got Not a directory for {target}.")


def test_a_page_that_cannot_be_written_after_all_is_one_line(recording, diagnosed, tmp_path, monkeypatch, capsys):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gyro_calib.report.page.tempfile.mkstemp", full)
    assert main(["diagnose", str(recording), "--html", str(tmp_path / "gap.html")]) == 1
    out = capsys.readouterr()
    assert "Which effects" in out.out
    assert out.err.splitlines()[-1].startswith("gyro-calib diagnose: Page must be writable, but got No space left on device for ")


def test_a_description_of_another_kind_is_refused_before_the_diagnosis(recording, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("gyro_calib.gap.diagnose", lambda *arguments, **options: pytest.fail("diagnosed"))
    assert main(["diagnose", str(recording), "--device", "hrg_sun2024", "--patched-device", str(tmp_path / "p.yaml")]) == 1
    err = capsys.readouterr().err
    assert "nominal frequency of about 15000 Hz, but got 'hrg_sun2024' of 5000 Hz" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("across", "by_axis"), [(0.0, False), (5.0, True)])
def test_axes_that_are_turned_are_the_variant_by_axis(across: float, by_axis: bool) -> None:
    """Equal sizes of both axes are alike in all directions only if nothing acts from one to the other."""
    sizes = {name: Quantity(value, 0.5, "1/s/V^2") for name, value in (("c_x", 9.0), ("c_y", 9.0), ("c_xy", across), ("c_yx", -across))}
    found = FoundEffect("nonlinear_damping", "", ("nonlinear_damping",), 0.9, sizes, "dynamics", "nonlinear_damping_axes", 300.0)
    assert ("nonlinear_damping_axes" in found.to_json()["group"]) is by_axis


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--patched-device", "p.yaml"), 2, "--device"),
        (("--device", "no_such_device", "--patched-device", "p.yaml"), 1, "no_such_device"),
        (("--nonsense",), 2, "--nonsense"),
    ],
)
def test_usage_and_missing_files(recording, tmp_path, monkeypatch, capsys, options, code, words):
    monkeypatch.chdir(tmp_path)
    assert main(["diagnose", str(recording), *options]) == code
    out = capsys.readouterr()
    assert words in out.err
    assert out.out == ""
    assert list(tmp_path.iterdir()) == []


# -- every verdict on the page ------------------------------------------------------------------------------------------------------------

SIZE = Quantity(0.0123, 2e-4, "1/V^2")


def diagnosis(verdict):
    found = FoundEffect("drive_nonlinearity", "Force not proportional", ("drive_nonlinearity", "drive_sag"), 0.97, {"d_x": SIZE}, "drive",
                        "drive_nonlinearity", 900.0)  # fmt: skip
    cells = tuple(
        Cell(f"static_{k}", channel, "in phase with velocity", feature, 0.01, z, z)
        for k in range(30)
        for channel, z in (("amplitude", 25.0 / (1 + k)), ("precession", 1.1), ("x pick-off", 0.8))
        for feature in ("mean", "side band 1 x 0.5 Hz", "8.0 theta")
    )
    standings = (
        Standing("drive_nonlinearity", "Force", "drive", "present", None, 400.0, 900.0, 0.1),
        Standing("drive_sag", "Sag", "drive", "like drive_nonlinearity", None, 399.0, 898.0, 0.1),
        Standing("duffing", "Stiffness", "dynamics", "excluded", Quantity(0.01, 0.001, "rad/s/V^2"), -5.0, 1.0, 0.2),
        Standing("thermal_lag", "Lag", "environment", "not testable", None, 0.0, 0.0, 1.0),
    )
    gap = Gap(
        rms_before=8.8,
        rms_after=1.02,
        closed_fraction=Quantity(0.98, 0.01, "1"),
        bias_before=Quantity(120.0, 3.0, "deg/h"),
        bias_after=Quantity(4.0, 3.0, "deg/h"),
        scale_before=Quantity(900.0, 20.0, "ppm"),
        scale_after=Quantity(0.0, 20.0, "ppm"),
    )
    following = NextExperiment(
        "Record a ring-up.", "tell them apart", ("drive_sag",), (Alternative("Record longer.", tuple("abcdefgh"), 0.1),)
    )
    return Diagnosis(
        device_id="unit <7>",
        verdict=verdict,
        summary=f"The verdict is {verdict}.",
        effects=(found,) if verdict == "effects" else (),
        unknown=Unknown("drive", "in phase", "|u|^2 u", "amplitude", "drive_sag", 50.0) if verdict == "unknown" else None,
        map=cells,
        standings=standings,
        gap=gap,
        not_testable=("thermal_lag",),
        next_experiment=following,
        chi2_before=9000.0,
        chi2_after=110.0,
        dof=100,
        probability_none=0.01,
        probability_unknown=0.02,
        recordings=30,
        elapsed_s=12.0,
        warnings=("static_3 is cut short",),
    )


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_of_every_verdict(verdict):
    page = gap_page(diagnosis(verdict))
    text = render_page(page)
    assert page.passed is {"none": True, "effects": True, "unknown": False, "not_testable": None}[verdict]
    assert "unit &lt;7&gt;" in text
    assert "Record a ring-up." in text
    assert "It decides a, b, c, d, e, f and more." in text
    assert "static_3 is cut short" in text
    assert "excluded above 0.01 rad/s/V^2" in text
    assert ("cannot be told from drive_sag" in text) is (verdict == "effects")
    assert ("grows as |u|^2 u" in text) is (verdict == "unknown")
    labels = {tile.label for tile in page.tiles}
    assert ("Gap closed, unseen experiments" in labels) is (verdict == "effects")
    assert {"Rate left unexplained", "Bend of the scale factor"} <= labels
    picture = page.panels[0]
    assert "6 experiments not shown reach 1.1" in picture.conclusion
    assert ">static_0<" in picture.svg
    assert ">static_29<" not in picture.svg


@pytest.mark.parametrize("verdict", ["none", "unknown"])
def test_probabilities_of_a_device_without_names_add_up(verdict):
    shares = [float(row[2].removesuffix(" %")) for row in effects_table(diagnosis(verdict)).rows]
    assert sum(shares) == pytest.approx(100.0)


def test_a_limit_is_worded_by_status():
    limit = Quantity(0.25, 0.01, "1/V^2")
    words = [status_words(Standing("a", "A", "drive", s, limit, 0.0, 0.0, 0.0)) for s in ("excluded", "cannot tell", "not testable")]
    assert words == ["excluded above 0.25 1/V^2", "cannot tell below 0.25 1/V^2", "not testable below 0.25 1/V^2"]


# -- another plant ------------------------------------------------------------------------------------------------------------------------

#: a healthy device and one that is not, a hemisphere and a ring: the others take as long again
SOONEST = ("ring_b", "hrg_a")
FILES = {"ring_a": (), "ring_b": ("nonlinear_damping",), "hrg_a": (), "hrg_b": ("pickoff_nonlinearity",)}


@pytest.fixture(scope="session")
def benched(tmp_path_factory):
    """Each practice file diagnosed once, through the command."""
    folder, found = tmp_path_factory.mktemp("bench"), {}

    def diagnosed(name):
        if name not in found:
            target = folder / f"{name}.json"
            assert main(["diagnose", str(BENCH / f"{name}.h5"), "--json", str(target)]) == 0
            found[name] = json.loads(target.read_text())
        return found[name]

    return diagnosed


@needs_bench
@pytest.mark.parametrize("name", [pytest.param(name, marks=[] if name in SOONEST else pytest.mark.slow) for name in FILES])
def test_practice_recordings_of_another_plant(benched, name):
    document = benched(name)
    assert document["verdict"] == ("effects" if FILES[name] else "none"), document["summary"]
    assert {e["name"] for e in document["effects"]} == set(FILES[name])
    assert document["unknown"] is None
    if FILES[name]:
        assert document["gap"]["closed_fraction"]["value"] >= 0.9
        assert document["gap"]["after"]["rms_over_noise"] <= 1.2
