"""What this package adds to the bare middleware: rows to blocks and back against rclpy, reading a bag against iterating over it.

python benchmarks/blocks_and_bags.py [--quick] [--json FILE]

A block of 100 rows (0.2 s at 500 Hz). rclpy: serialising and deserialising the same message, the least that a publish and a take cost,
without any transport. Bag: a quick self-calibration as MCAP; rosbags: its reader with every message of the two topics deserialised. The
same campaign in HDF5 for comparison.
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import Options, Outcome, cpu_seconds, main, ratio, spread

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.quantity import Quantity
from gyro_calib.recording import read_campaign_bag, read_campaign_h5, write_campaign_bag, write_campaign_h5
from gyro_calib.recording.bag import BLOCKS_TYPE, EVENTS_TYPE, import_rosbags
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.study import Gate

ROWS = 100
#: what conversion may cost over serialisation, and reading over bare iteration
BLOCK_LIMIT, BAG_LIMIT = 1.0, 2.0


def measure(options: Options) -> Outcome:
    """Both comparisons; the part that lacks its library is left out and said so."""
    gates: list[Gate] = []
    facts: dict[str, Any] = {}
    try:
        gates += _blocks(options)
    except ImportError as error:
        facts["skipped"] = f"blocks: {error}"
    device = draw_unit(load_device("ring_15k"), 1)
    plan = self_calibration_plan(device.factory(), quality="quick")
    campaign = run_plan(SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(1), fidelity="slow_flow")), plan)
    return Outcome([*gates, *_bags(options, campaign)], facts)


def _blocks(options: Options) -> list[Gate]:
    """Conversion against serialisation, there and back."""
    from rclpy.serialization import deserialize_message, serialize_message
    from std_msgs.msg import Float64MultiArray

    from gyro_calib.nodes.blocks import block_from_rows, rows_from_block

    rows = np.random.default_rng(1).standard_normal((ROWS, len(COLUMNS)))
    message = block_from_rows(rows)
    wire = serialize_message(message)
    many = 100

    def repeat(work: Any, argument: Any) -> None:
        for _ in range(many):
            work(argument)

    works = {
        "rows to block": partial(repeat, block_from_rows, rows),
        "serialise (rclpy)": partial(repeat, serialize_message, message),
        "block to rows": partial(repeat, rows_from_block, message),
        "deserialise (rclpy)": partial(repeat, lambda data: deserialize_message(data, Float64MultiArray), wire),
        "block to rows through lists": partial(repeat, lambda m: np.array(list(m.data)).reshape(-1, len(COLUMNS)), message),
    }
    each = {name: spread(1e6 / many * values, "us") for name, values in cpu_seconds(works, 10 if options.quick else 60).items()}
    both = Quantity(each["rows to block"].value + each["block to rows"].value, 0.0, "us")
    bare = Quantity(each["serialise (rclpy)"].value + each["deserialise (rclpy)"].value, 0.0, "us")
    gates = [Gate(f"CPU time of a block, {name}", value) for name, value in each.items()]
    return [*gates, Gate("conversion / serialisation, both ways", ratio(both, bare), upper=BLOCK_LIMIT)]


def _bags(options: Options, campaign: Campaign) -> list[Gate]:
    rosbag2, store = import_rosbags()

    def iterate(path: Path) -> None:
        with rosbag2.Reader(path) as reader:
            wanted = [c for c in reader.connections if c.msgtype in (BLOCKS_TYPE, EVENTS_TYPE)]
            for connection, _, data in reader.messages(connections=wanted):
                store.deserialize_cdr(data, connection.msgtype)

    with tempfile.TemporaryDirectory() as folder:
        bag = write_campaign_bag(Path(folder) / "bag", campaign)
        file = Path(folder) / "campaign.h5"
        write_campaign_h5(file, campaign)
        works = {
            "rosbags, deserialised": partial(iterate, bag),
            "campaign from the bag, unchecked": partial(read_campaign_bag, bag, check=False),
            "campaign from the bag": partial(read_campaign_bag, bag),
            "campaign from HDF5": partial(read_campaign_h5, file),
        }
        times = cpu_seconds(works, 5 if options.quick else 25)
    lasted = sum(recording.duration_s for recording in campaign)
    each = {name: spread(1e3 * values, "ms") for name, values in times.items()}
    gates = [Gate(f"{lasted:.0f} s of records, {name}", value) for name, value in each.items()]
    bare = each["rosbags, deserialised"]
    gates.append(Gate("bag, unchecked / rosbags, deserialised", ratio(each["campaign from the bag, unchecked"], bare), upper=BAG_LIMIT))
    return [*gates, Gate("bag / rosbags, deserialised", ratio(each["campaign from the bag"], bare))]


if __name__ == "__main__":
    sys.exit(main("blocks_and_bags", measure))
