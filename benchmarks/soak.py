"""Months in short: the nodes at full rate for an hour, their memory sampled, every message checked.

Real processes. imu_corrector gets a raw rate at 1 kHz and every sensor_msgs/Imu is held against its raw sample; a simulated gyro, the
calibration node and a second corrector run beside it in real time. After a warm-up of a fifth of the time the resident memory of no process
may grow, nothing may be wrong or out of order, and next to nothing lost.

python benchmarks/soak.py [--seconds 3600] [--json FILE]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from common import Options, Outcome, gate_table, machine
from ros_room import ros_room

from gyro_calib.cli.console import print_table, progress_bar, write_json
from gyro_calib.quantity import Quantity
from gyro_calib.report.table import Table
from gyro_calib.study import Gate

if TYPE_CHECKING:
    from ros_helpers import RosSession
    from ros_processes import NodeProcess

ROOT = Path(__file__).resolve().parents[1]
RATE_HZ = 1000
HOUR_S = 3600.0
#: share of the run in which memory may still settle
WARM_UP = 0.2
#: growth after that which is still flat: allocators give and take some pages [MiB]
FLAT_MIB = 1.0
#: share of the samples that a loaded machine may lose
LOST = 1e-3
_PERIOD_NS = 1_000_000_000 // RATE_HZ
_EPOCH_NS = 1_000_000_000_000


@dataclass
class Stream:
    """A raw rate that anybody can compute from its stamp, and what became of it."""

    bias_rad_s: float
    scale_factor: float
    sent: int = 0
    received: int = 0
    wrong: int = 0
    disordered: int = 0
    _last: int = field(default=-1, repr=False)

    def raw(self, number: int) -> float:
        """Sample ``number`` [rad/s]."""
        return 0.5 * float(np.sin(0.001 * number)) + 1e-3 * (number % 7)

    def check(self, message: Any) -> None:
        """Hold an Imu against the sample of its stamp."""
        stamp = message.header.stamp
        number = (stamp.sec * 1_000_000_000 + stamp.nanosec - _EPOCH_NS) // _PERIOD_NS
        wanted = (self.raw(number) - self.bias_rad_s) / self.scale_factor
        self.received += 1
        self.wrong += not (abs(message.angular_velocity.z - wanted) < 1e-12 and 0.0 < message.angular_velocity_covariance[8] < 1.0)
        self.disordered += number <= self._last
        self._last = number


def measure(options: Options) -> Outcome:
    """Two minutes as one benchmark of many, 20 s when quick; :func:`soak` for longer."""
    return soak(20.0 if options.quick else 120.0)


def soak(seconds: float) -> Outcome:
    """Run for ``seconds`` and sample."""
    sys.path.insert(0, str(ROOT / "test"))
    with ros_room() as folder:
        from calibration_samples import make_record
        from ros_helpers import RosSession

        from gyro_calib.calibration import RecordStore

        record = make_record(validity={})
        RecordStore(folder / "record.yaml", record.device_id).save(record)
        stream = Stream(record.bias.value, record.scale_factor.value)
        with RosSession() as session, _nodes(folder, record.device_id) as processes:
            samples, cpu_s = _run(session, processes, stream, seconds)
    return _outcome(stream, samples, cpu_s, seconds)


@contextlib.contextmanager
def _nodes(folder: Path, device_id: str) -> Iterator[dict[str, NodeProcess]]:
    from ros_processes import start_node

    corrector = {"record_urls": [str(folder / "record.yaml")], "device_ids": [device_id]}
    simulator = {"fidelity": "slow_flow", "seed": 7}
    processes = {
        "imu_corrector, 1 kHz": start_node("imu_corrector_node", folder=folder, namespace="/soak", parameters=corrector),
        "gyro_sim": start_node("gyro_sim_node", folder=folder, namespace="/rest", parameters=simulator),
        "gyro_calibration": start_node("calibration_node", folder=folder, namespace="/rest"),
        "imu_corrector, 100 Hz": start_node("imu_corrector_node", folder=folder, namespace="/rest"),
    }
    try:
        yield processes
    finally:
        for process in processes.values():
            process.stop()


def _run(
    session: RosSession, processes: Mapping[str, NodeProcess], stream: Stream, seconds: float
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Publish and sample; memory by process, shape (n, 2): time [s] and resident memory [MiB]; CPU time used by each [s]."""
    from geometry_msgs.msg import TwistStamped
    from ros_processes import wait_for
    from sensor_msgs.msg import Imu

    from gyro_calib.nodes.runtime import SENSOR_PUB_QOS, SENSOR_SUB_QOS

    node = session.node("source", "/soak")
    publisher = node.create_publisher(TwistStamped, "rate_raw", SENSOR_PUB_QOS)
    node.create_subscription(Imu, "imu/data_raw", stream.check, SENSOR_SUB_QOS)
    wait_for(lambda: publisher.get_subscription_count() and node.count_publishers("/soak/imu/data_raw"), 60.0, "the corrector")
    time.sleep(3.0)  # all ends have found each other, and the other nodes run
    ended = threading.Event()
    source = threading.Thread(target=_publish, args=(publisher, TwistStamped(), stream, ended), name="source")
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in processes}
    began, cpu = time.monotonic(), {name: _cpu_s(process) for name, process in processes.items()}
    source.start()
    try:
        with progress_bar(f"{seconds:g} s at {RATE_HZ} Hz", lines=True) as report:
            while (elapsed := time.monotonic() - began) < seconds:
                for name, process in processes.items():
                    found[name].append((elapsed, _resident_mib(process)))
                report(elapsed / seconds, f"{stream.received} of {stream.sent}, {stream.wrong} wrong")
                time.sleep(min(5.0, seconds / 60.0))
    finally:
        ended.set()
        source.join()
    time.sleep(1.0)
    return {name: np.array(rows) for name, rows in found.items()}, {n: _cpu_s(p) - cpu[n] for n, p in processes.items()}


def _publish(publisher: Any, message: Any, stream: Stream, ended: threading.Event) -> None:
    """Every sample that is due, each time the machine lets us: late ones leave as a burst, as from a driver behind a busy bus."""
    began = time.monotonic()
    while not ended.is_set():
        due = int((time.monotonic() - began) * RATE_HZ)
        while stream.sent < due:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(_EPOCH_NS + stream.sent * _PERIOD_NS, 1_000_000_000)
            message.twist.angular.z = stream.raw(stream.sent)
            publisher.publish(message)
            stream.sent += 1
        time.sleep(0.0005)


def _resident_mib(process: NodeProcess) -> float:
    fields = Path(f"/proc/{process.process.pid}/statm").read_text().split()
    return int(fields[1]) * resource.getpagesize() / 2**20


def _cpu_s(process: NodeProcess) -> float:
    fields = Path(f"/proc/{process.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def growth_mib(samples: np.ndarray) -> tuple[float, float]:
    """Growth after the warm-up [MiB]: median of the last tenth less that of the first one after it; and the slope [MiB/h]."""
    settled = samples[samples[:, 0] >= WARM_UP * samples[-1, 0]]
    tenth = max(1, len(settled) // 10)
    slope = float(np.polyfit(settled[:, 0] / HOUR_S, settled[:, 1], 1)[0])
    return float(np.median(settled[-tenth:, 1]) - np.median(settled[:tenth, 1])), slope


def _outcome(stream: Stream, samples: Mapping[str, np.ndarray], cpu_s: Mapping[str, float], seconds: float) -> Outcome:
    grown = {name: growth_mib(rows) for name, rows in samples.items()}
    rows = tuple(
        (name, f"{rows[-1, 1]:.1f}", f"{grown[name][0]:+.2f}", f"{grown[name][1]:+.2f}", f"{100.0 * cpu_s[name] / seconds:.0f} %")
        for name, rows in samples.items()
    )
    print_table(Table(f"Memory over {seconds:g} s", ("process", "resident [MiB]", "growth [MiB]", "slope [MiB/h]", "CPU"), rows))
    lost = 1.0 - stream.received / max(stream.sent, 1)
    gates = [Gate(f"growth of {name}", Quantity(value, 0.0, "MiB"), upper=FLAT_MIB) for name, (value, _) in grown.items()]
    gates += [
        Gate("samples lost", Quantity(lost, 0.0, "1"), upper=LOST),
        Gate("samples wrong", Quantity(float(stream.wrong), 0.0, "1"), upper=0.0),
        Gate("samples out of order", Quantity(float(stream.disordered), 0.0, "1"), upper=0.0),
    ]
    facts = {
        "seconds": seconds,
        "sent": stream.sent,
        "received": stream.received,
        "resident_mib": {name: [[round(t), round(mib, 3)] for t, mib in rows] for name, rows in samples.items()},
        "growth_mib": {name: value for name, (value, _) in grown.items()},
        "slope_mib_per_h": {name: slope for name, (_, slope) in grown.items()},
        "cpu_share": {name: used / seconds for name, used in cpu_s.items()},
    }
    return Outcome(gates, facts)


def main() -> int:
    """Command line; exit code 1 when a gate does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=HOUR_S, metavar="S", help="how long (default: an hour)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    outcome = soak(arguments.seconds)
    print_table(gate_table("soak", outcome.gates))
    if arguments.json is not None:
        write_json(arguments.json, {"machine": machine(), "soak": outcome.to_json()})
    return 0 if outcome.passed else 1


if __name__ == "__main__":
    sys.exit(main())
