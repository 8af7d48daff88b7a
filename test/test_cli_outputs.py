"""What a command is to write: refused before its work when it cannot be written, whoever asks; nothing is left by asking."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from gyro_calib.cli.main import main
from gyro_calib.cli.outputs import check_output, check_outputs
from gyro_calib.errors import DataError
from gyro_calib.trial.run import TrialLog


def test_what_can_be_written_passes_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "there.json").write_text("old")
    outputs = Namespace(
        json=tmp_path / "there.json",
        html=tmp_path / "new" / "deep" / "page.html",
        plot=None,
        log=Path("/dev/null"),
        out=tmp_path / "folder",
    )
    check_outputs(outputs, "json", "html", "plot", "log", "out")
    check_outputs(Namespace(json=Path("-")), "json")
    assert [path.name for path in tmp_path.iterdir()] == ["there.json"]
    assert (tmp_path / "there.json").read_text() == "old"


@pytest.mark.parametrize(
    ("name", "place", "reason"),
    [
        ("html", "folder", "Is a directory"),
        ("json", "file/page", "Not a directory"),
        ("json", "file/deep/page", "Not a directory"),
        ("out", "file", "Not a directory"),
        ("plot", "p" * 300, "File name too long"),
        ("log", "/proc/log.txt", "No such file or directory"),
    ],
)
def test_what_cannot_be_written_is_told_with_option_and_path(tmp_path: Path, name: str, place: str, reason: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(DataError, match=f"Output --{name} must be writable, but got {reason} for .*{place}. Choose another path."):
        check_outputs(Namespace(**{name: tmp_path / place}), name)


def test_a_file_that_is_written_where_it_stands_needs_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of one's own in a folder of another's: JSON can be written, a page, which takes its place at once, cannot."""

    def refused(*arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "own").write_text("old")
    monkeypatch.setattr("gyro_calib.cli.outputs.tempfile.TemporaryFile", refused)
    check_output("--json", tmp_path / "own", in_place=True)
    with pytest.raises(DataError, match="Output --html must be writable, but got Permission denied"):
        check_output("--html", tmp_path / "own")


@pytest.mark.parametrize(
    "arguments",
    [
        ("allan", "absent.csv", "--rate-hz", "1", "--json"),
        ("allan", "absent.csv", "--rate-hz", "1", "--html"),
        ("allan", "absent.csv", "--rate-hz", "1", "--plot"),
        ("blind-trial", "--trials", "1", "--json"),
        ("blind-trial", "--trials", "1", "--log"),
        ("blind-trial", "--trials", "1", "--plot"),
        ("calibrate", "absent.h5", "--json"),
        ("calibrate", "absent.h5", "--html"),
        ("compare", "absent.yaml", "--json"),
        ("compare", "absent.yaml", "--html"),
        ("demo", "--json"),
        ("demo", "--out"),
        ("diagnose", "absent.h5", "--json"),
        ("diagnose", "absent.h5", "--html"),
        ("diagnose", "absent.h5", "--device", "ring_15k", "--patched-device"),
        ("factory", "absent.h5", "--json"),
        ("pickoff", "absent.h5", "--json"),
        ("simulate", "ring_15k", "--plan", "static", "--out"),
        ("study", "earth_rate", "--json"),
        ("study", "earth_rate", "--plot"),
    ],
)
def test_every_command_asks_before_its_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, arguments) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    command, option = arguments[0], arguments[-1]
    monkeypatch.setattr("gyro_calib.study.find_study", lambda name: name)
    assert main([*arguments, "file/there.png"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"gyro-calib {command}: Output {option} must be writable, but got Not a directory for file/there.png.")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(("command", "option"), [("calibrate", "--record"), ("factory", "--store")])
def test_a_store_is_asked_once_the_device_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, command, option) -> None:  # type: ignore[no-untyped-def]
    class Told:
        device_id = "ring-0001"

    (tmp_path / "file").write_text("")
    monkeypatch.setattr("gyro_calib.recording.load.load_campaign", lambda *paths, **options: Told())
    target = tmp_path / "file" / "record.yaml"
    assert main([command, "any.h5", option, str(target)]) == 1
    assert f"Output {option} must be writable, but got Not a directory for {target}." in capsys.readouterr().err


def test_a_log_that_cannot_be_written_is_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="Log of the trials must be writable"):
        TrialLog(tmp_path / "file" / "log.txt")
    TrialLog(tmp_path / "new" / "log.txt")
    assert (tmp_path / "new" / "log.txt").read_text() == ""
