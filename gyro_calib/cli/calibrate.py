"""Calibrate a device from its recordings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import print_table, print_warnings, progress_bar, say, spinner, write_json
from .outputs import check_output, check_outputs

if TYPE_CHECKING:
    from ..estimation import CalibrationResult
    from ..recording.recording import Campaign


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help="HDF5 files, ROS 2 bags or folders, of one device")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result; - for stdout")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a report page")
    parser.add_argument(
        "--record",
        metavar="URL",
        help="also store the calibration record: a file or its URL; default: the one of the device in $ROS_HOME",
        nargs="?",
        const="",
    )
    parser.add_argument(
        "--factory-record",
        metavar="URL",
        default="",
        help="factory record (see gyro-calib factory) whose kappa and rate correction count; none: leave it; else the one in $ROS_HOME",
    )
    parser.add_argument(
        "--method",
        default="auto",
        metavar="NAME",
        help="auto, or one of sideband, document (document 000 to the letter), virtual_precession",
    )
    parser.add_argument(
        "--drop-one",
        action="store_true",
        help="estimate again without each kind of recording and source: what carries each figure, what contradicts it (force to rebalance)",
    )
    parser.add_argument("--topic", metavar="TOPIC", help="the channels topic, for a bag of several gyros")
    parser.add_argument("--device-id", metavar="ID", help="identity of the unit, for a bag that lacks it")


def run(arguments: argparse.Namespace) -> int:
    """Read, estimate, report."""
    with spinner("loading"):
        from ..estimation import calibrate
        from ..recording.load import load_campaign
        from ..report.calibration_page import result_table
        from ..report.theme import require_matplotlib

    if arguments.html is not None:
        require_matplotlib()
    check_outputs(arguments, "json", "html")
    with progress_bar("reading") as report:
        campaign = load_campaign(*arguments.recordings, topic=arguments.topic, device_id=arguments.device_id, on_progress=report)
    if arguments.record is not None:
        from ..calibration import RecordStore

        check_output("--record", RecordStore(arguments.record, campaign.device_id).path)
    campaign = _with_factory(campaign, arguments.factory_record)
    with progress_bar("estimating") as report:
        result = calibrate(
            campaign,
            method=arguments.method,
            on_progress=lambda fraction: report(fraction, ""),
            with_convergence=arguments.html is not None,
        )
    document = result.to_json()
    shown = arguments.json is None or str(arguments.json) != "-"
    if shown:
        print_table(result_table(result))
        for verdict in result.verdicts:
            say(verdict)
    if arguments.drop_one:
        document["drop_one"] = _drop_one(campaign, shown)
    print_warnings([*(f"not observable: {item}" for item in result.not_observable), *result.warnings])
    if arguments.json is not None:
        write_json(arguments.json, document)
    if arguments.html is not None:
        _write_page(arguments, campaign, result)
    if arguments.record is not None:
        _store(arguments, campaign, result)
    return 0


def _store(arguments: argparse.Namespace, campaign: Campaign, result: CalibrationResult) -> None:
    """The record, as a run of the calibration node would have stored it."""
    from ..calibration import RecordStore, record_from_result
    from ..experiments import mission_mode

    run_id = "calibrate " + ", ".join(path.name for path in arguments.recordings)
    record = record_from_result(result, campaign, run_id=run_id, mode=mission_mode(campaign.factory))
    path = RecordStore(arguments.record, campaign.device_id).save(record)
    if arguments.json is None or str(arguments.json) != "-":
        say(f"record: {record.record_id} in {path}")


def _drop_one(campaign: Campaign, shown: bool) -> dict[str, Any]:
    """The estimate without each source in turn, as a table and as JSON."""
    from ..estimation.drop_one import drop_one
    from ..report.drop_one_table import drop_one_table

    with progress_bar("leaving out") as report:
        found = drop_one(campaign, on_progress=lambda fraction: report(fraction, ""))
    if shown:
        print_table(drop_one_table(found))
    return found.to_json()


def _with_factory(campaign: Campaign, url: str) -> Campaign:
    """What the factory's rate table found, where it was stored."""
    from ..calibration import FactoryStore, with_factory_record
    from ..errors import StoreError

    if url == "none":
        return campaign
    store = FactoryStore(url, campaign.device_id)
    record = store.load()
    if record is None and url:
        raise StoreError(f"Factory record {store.path} must exist, but does not. Correct --factory-record, or leave it out.")
    return with_factory_record(campaign, record)


def _write_page(arguments: argparse.Namespace, campaign: Campaign, result: CalibrationResult) -> None:
    from ..paths import package_version
    from ..report.calibration_page import RunFacts, calibration_page
    from ..report.page import write_page

    names = ", ".join(path.name for path in arguments.recordings)
    lasted = sum(recording.duration_s for recording in campaign)
    facts = RunFacts(
        title=f"Calibration of {campaign.device_id}",
        subtitle=f"From {len(campaign)} recordings in {names}, method {result.method}.",
        footer=f"gyro_calib {package_version()}",
        device_s=lasted,
    )
    with spinner("drawing the report"):
        write_page(arguments.html, calibration_page(result, campaign, facts))
    if arguments.json is None or str(arguments.json) != "-":
        say(f"report: {arguments.html}")
