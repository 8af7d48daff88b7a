"""Diagnose where a device and its simulation differ, by which effect, and how far the gap shrinks."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from .console import print_table, print_warnings, progress_bar, say, spinner, write_json
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..device import Device
    from ..gap import Diagnosis
    from ..gap.fleet_file import Fleet
    from ..recording.recording import Campaign


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help="HDF5 files, ROS 2 bags or folders, of one device")
    parser.add_argument("--device", metavar="DEVICE", help="nominal or previous device description: a YAML file, or a packaged one")
    parser.add_argument("--fleet", type=Path, metavar="FILE", help="what healthy units of this kind have, from gyro-calib fleet")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the diagnosis; - for stdout")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page with pictures")
    parser.add_argument("--patched-device", type=Path, metavar="FILE", help="write the device with what was found, for gyro-calib simulate")
    parser.add_argument("--topic", metavar="TOPIC", help="the channels topic, for a bag of several gyros")
    parser.add_argument("--device-id", metavar="ID", help="identity of the unit, for a bag that lacks it")
    parser.add_argument("--all", action="store_true", help="print the line of every effect, not only of those found")


def run(arguments: argparse.Namespace) -> int:
    """Read, diagnose, report."""
    if arguments.patched_device is not None and arguments.device is None:
        return _usage("--patched-device needs --device: the description whose linear part and effects are replaced")
    with spinner("loading"):
        from ..gap import diagnose
        from ..gap.provenance import with_provenance
        from ..recording.load import load_campaign
        from ..report.theme import require_matplotlib

    device, fleet = _device(arguments.device), _fleet(arguments.fleet)
    if arguments.html is not None:
        require_matplotlib()
    check_outputs(arguments, "json", "html", "patched_device")
    with progress_bar("reading") as report:
        campaign = load_campaign(*arguments.recordings, topic=arguments.topic, device_id=arguments.device_id, on_progress=report)
    if device is not None:
        from ..gap.patch import check_kind

        check_kind(device, campaign.factory)
    if fleet is not None:
        fleet.check_kind(campaign.factory)
    with progress_bar("diagnosing") as report:
        diagnosis = diagnose(campaign, healthy=fleet.healthy if fleet else None, on_progress=report)
    diagnosis = with_provenance(diagnosis, arguments.recordings, fleet)
    shown = arguments.json is None or str(arguments.json) != "-"
    try:
        # before the terminal, which may be gone: `| head` closes it
        if arguments.json is not None:
            write_json(arguments.json, diagnosis.to_json())
    finally:
        if shown:
            print_diagnosis(diagnosis, every=arguments.all)
        print_warnings(diagnosis.warnings)
    if arguments.html is not None:
        from ..report.gap_page import write_gap_page

        with spinner("drawing the report"):
            write_gap_page(arguments.html, diagnosis)
        if shown:
            say(f"report: {arguments.html}")
    if arguments.patched_device is not None and device is not None:
        _write_patched(arguments.patched_device, device, campaign, diagnosis, shown)
    return 0


def print_diagnosis(diagnosis: Diagnosis, *, every: bool = False) -> None:
    """The verdict that a person reads in a minute."""
    from ..report.gap_tables import as_healthy_table, before_after_table, effects_table, places_table, sentences_of_next, standings_table

    fleet = diagnosis.provenance.get("fleet")
    beside = f", judged beside the fleet of {fleet['name']}" if fleet else ""
    say(f"{diagnosis.device_id}, {diagnosis.recordings} recordings{beside}: {diagnosis.verdict}")
    say(diagnosis.summary)
    say("")
    held = [as_healthy_table(diagnosis)] if diagnosis.as_healthy else []
    for table in (effects_table(diagnosis), *held, places_table(diagnosis), before_after_table(diagnosis)):
        print_table(table)
    if every:
        print_table(standings_table(diagnosis))
    following, *others = sentences_of_next(diagnosis)
    say(f"Next experiment: {following}")
    for sentence in others:
        say(f"  {sentence}")
    if diagnosis.not_testable:
        say(f"Not testable with these recordings: {', '.join(diagnosis.not_testable)}.")


def _device(source: str | None) -> Device | None:
    from ..device import load_device

    return None if source is None else load_device(source)


def _fleet(path: Path | None) -> Fleet | None:
    if path is None:
        return None
    from ..gap.fleet_file import read_fleet

    return read_fleet(path)


def _write_patched(path: Path, device: Device, campaign: Campaign, diagnosis: Diagnosis, shown: bool) -> None:
    from ..device import dump_device
    from ..gap.patch import patch_notes, patched_device, with_factory_data

    patched = patched_device(with_factory_data(device, campaign.factory, diagnosis), diagnosis)
    notes = patch_notes(patched, diagnosis)
    dump_device(patched, path, notes)
    if shown:
        say(f"patched device: {path}")
        for note in notes[2:4]:
            say(f"  {note}")


def _usage(text: str) -> int:
    print(f"gyro-calib diagnose: {text}", file=sys.stderr)
    return 2
