"""Commands that need ROS 2, against real node processes and against a calibration node that answers as it is told."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from itertools import count
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue  # noqa: E402
from diagnostic_msgs.srv import SelfTest  # noqa: E402
from geometry_msgs.msg import TwistStamped  # noqa: E402
from ros_processes import ROOT, wait_for  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from gyro_calib.cli.domain import leased_domain  # noqa: E402
from gyro_calib.cli.main import main  # noqa: E402
from gyro_calib.cli.processes import NodeGroup, ros_arguments  # noqa: E402
from gyro_calib.nodes.runtime import LATCHED_QOS, SENSOR_PUB_QOS  # noqa: E402


class ScriptedCalibration:
    """Offers the services of a calibration node; a run plays a list of states."""

    def __init__(self, session, states, *, accepts=True):
        self.node = session.node("gyro_calibration", namespace="/gyro")
        self._states, self._accepts = states, accepts
        self._status = self.node.create_publisher(DiagnosticStatus, "~/status", LATCHED_QOS)
        self.node.create_service(Trigger, "~/self_calibrate", self._start)
        self.node.create_service(Trigger, "~/save", self._save)
        self.node.create_service(SelfTest, "~/self_test", self._test)
        self.say("run-0", "failed", 1.0, "an old run that has nothing to do with the new one")

    def say(self, run, state, fraction, message):
        values = {"run": run, "state": state, "fraction": str(fraction), "eta_s": "unknown", "message": message}
        self._status.publish(DiagnosticStatus(name="s", values=[KeyValue(key=k, value=v) for k, v in values.items()]))

    def _start(self, _, response):
        response.success, response.message = self._accepts, "accepted run run-1" if self._accepts else "refused: a run is in progress"
        if self._accepts:
            threading.Thread(target=self._play, daemon=True).start()
        return response

    def _play(self):
        for state in self._states:
            time.sleep(0.1)
            self.say("run-1", *state)

    def _save(self, _, response):
        response.success, response.message = True, "saved"
        return response

    def _test(self, _, response):
        response.passed, response.id = b"\x00", "ring-7"
        response.status = [DiagnosticStatus(name="stream", level=b"\x02", message="no block came")]
        return response


RUNNING = ("running", 0.5, "step 1 of 2: static_x")


def test_call_waits_for_the_end_of_its_own_run(ros, capfd):
    ScriptedCalibration(ros, [RUNNING, ("estimating", 1.0, "estimating"), ("done", 1.0, "bias found")])
    assert main(["call", "self_calibrate"]) == 0
    captured = capfd.readouterr()
    assert captured.out == "bias found\n"
    assert "self_calibrate: 50 % step 1 of 2: static_x" in captured.err


@pytest.mark.parametrize(("state", "reason"), [("failed", "the stream stopped"), ("cancelled", "somebody cancelled")])
def test_call_ends_with_1_and_the_reason(ros, capfd, state, reason):
    ScriptedCalibration(ros, [RUNNING, (state, 0.5, reason)])
    assert main(["call", "self_calibrate"]) == 1
    assert capfd.readouterr().err.endswith(f"gyro-calib call: {reason}\n")


def test_call_tells_a_refusal(ros, capfd):
    ScriptedCalibration(ros, [], accepts=False)
    assert main(["call", "self_calibrate"]) == 1
    assert "refused: a run is in progress" in capfd.readouterr().err


def test_call_of_what_ends_at_once(ros, capfd):
    ScriptedCalibration(ros, [])
    assert main(["call", "save"]) == 0
    assert capfd.readouterr().out == "saved\n"
    assert main(["call", "self_calibrate", "--no-wait"]) == 0
    assert capfd.readouterr().out == "accepted run run-1\n"
    assert main(["call", "self_test"]) == 1
    out = capfd.readouterr().out
    assert "Self-test of ring-7: FAILED" in out
    assert re.search(r"stream\s+error\s+no block came", out)


def test_call_switches_the_corrector(ros, capfd):
    asked = []

    def answer(request, response):
        asked.append(request.data)
        response.success, response.message = request.data, "on" if request.data else "cannot be switched off"
        return response

    ros.node("imu_corrector", namespace="/gyro").create_service(SetBool, "~/enable", answer)
    assert main(["call", "enable"]) == 0
    assert main(["call", "disable"]) == 1
    assert asked == [True, False]
    captured = capfd.readouterr()
    assert captured.out == "on\n"
    assert captured.err == "cannot be switched off\n"


def test_call_notices_that_the_node_is_gone(ros, capfd, monkeypatch):
    monkeypatch.setattr("gyro_calib.cli.ros_client._GONE_S", 0.5)
    scripted = ScriptedCalibration(ros, [RUNNING])
    threading.Timer(1.0, scripted.node.destroy_publisher, [scripted._status]).start()
    assert main(["call", "self_calibrate"]) == 1
    assert "The calibration node is gone" in capfd.readouterr().err


def test_call_says_that_nobody_is_there(ros_environment, monkeypatch, capfd):
    monkeypatch.setattr("gyro_calib.cli.ros_client.RosClient.call.__kwdefaults__", {"discovery_s": 0.5})
    monkeypatch.setattr("gyro_calib.cli.ros_client.RosClient.start_run.__kwdefaults__", {"discovery_s": 0.5})
    assert main(["call", "self_calibrate", "--namespace", "nowhere"]) == 1
    assert "Service /nowhere/gyro_calibration/self_calibrate must be offered" in capfd.readouterr().err


def test_domains_are_leased_one_by_one():
    with leased_domain() as first, leased_domain() as second:
        assert first != second
        assert {first, second} <= set(range(102))


def test_arguments_of_a_node_are_yaml():
    arguments = ros_arguments("/a/b/", {"seed": 3, "device": "my ring: 7", "fast": True, "axes": [0.0, 1.0]})
    assert arguments[:3] == ["--ros-args", "-r", "__ns:=/a/b"]
    assert arguments[3:] == ["-p", "seed:=3", "-p", "device:='my ring: 7'", "-p", "fast:=true", "-p", "axes:=[0.0, 1.0]"]


def test_children_do_not_outlive_their_parent(tmp_path):
    """The parent is killed, without a chance to clean up; its nodes end all the same."""
    (tmp_path / "sleeper.py").write_text("import time\n\ndef main():\n    print('up', flush=True)\n    time.sleep(600)\n")
    code = (
        "import time\nfrom gyro_calib.cli.processes import NodeGroup\n"
        "group = NodeGroup({}, lambda name, line: print(line, flush=True))\n"
        "group.start('sleeper', 'sleeper', [])\nprint(group._children[0].process.pid, flush=True)\ntime.sleep(600)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment)
    child = int(parent.stdout.readline())
    assert parent.stdout.readline() == "up\n"
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait_for(lambda: not Path(f"/proc/{child}").exists() or "Z" in Path(f"/proc/{child}/stat").read_text().split()[2], 20.0, "the child")


def test_group_stops_the_stubborn_too(tmp_path, monkeypatch):
    deaf = "signal.signal(signal.SIGINT, signal.SIG_IGN)"
    code = f"import signal, time\n\ndef main():\n    {deaf}\n    print('up', flush=True)\n    time.sleep(600)\n"
    (tmp_path / "stubborn.py").write_text(code)
    monkeypatch.setattr("gyro_calib.cli.processes._PATIENCE_S", 0.5)
    lines = []
    with NodeGroup({"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}, lambda *line: lines.append(line)) as group:
        group.start("stubborn", "stubborn", [])
        wait_for(lambda: lines, 20.0, "the child's output")
        assert group.ended() is None
        process = group._children[0].process
    assert process.returncode == -signal.SIGKILL
    assert lines == [("stubborn", "up")]


def test_up_starts_three_nodes_and_ends_on_sigint(ros_environment):
    command = [sys.executable, "-m", "gyro_calib.cli", "up", "--seed", "4", "--namespace", "cell"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=ros_environment)
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.extend(process.stdout), daemon=True)
    reader.start()
    try:
        wait_for(lambda: any("ring_15k-0004" in line for line in lines), 60.0, "the simulator's greeting")
        wait_for(lambda: main(["call", "self_test", "--namespace", "cell"]) in (0, 1), 30.0, "the calibration node")
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(40.0)
    reader.join(10.0)
    assert code == 0, lines
    assert all(re.match(r" *(gyro_sim|gyro_calibration|imu_corrector) \| ", line) for line in lines), lines
    assert process.stderr.read().strip().endswith("ending the nodes")
    process.stderr.close()


def test_up_says_which_node_ended(ros_environment, capfd):
    assert main(["up", "--device", "nonsense"]) == 1
    assert "Device must be" in capfd.readouterr().err
    assert main(["up", "--realtime-factor", "-3", "--namespace", "cell"]) == 1
    captured = capfd.readouterr()
    assert re.search(r"node gyro_sim ended with exit code [1-9]", captured.err)


def test_consumer_integrates_standard_messages(ros):
    """The stranger's program, fed with rates that are known: 0.5 deg/s truly, 20 % more in the raw one."""
    node = ros.node("source", namespace="/gyro")
    raw = node.create_publisher(TwistStamped, "rate_raw", SENSOR_PUB_QOS)
    imu = node.create_publisher(Imu, "imu/data_raw", SENSOR_PUB_QOS)
    script = Path(__file__).with_name("consumer_yaw.py")
    assert "gyro_calib" not in re.sub(r'""".*?"""', "", script.read_text(), count=1, flags=re.DOTALL)
    process = subprocess.Popen([sys.executable, str(script), "--seconds", "20"], stdout=subprocess.PIPE, text=True)
    wait_for(lambda: raw.get_subscription_count() and imu.get_subscription_count(), 30.0, "the consumer")
    deadline = time.monotonic() + 60.0
    for k in count():
        # best effort: what a busy machine drops is sent again, later
        if process.poll() is not None or time.monotonic() > deadline:
            break
        twist, message = TwistStamped(), Imu()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(5_000_000_000 + k * 10_000_000, 10**9)
        twist.header.stamp = message.header.stamp
        twist.twist.angular.z, message.angular_velocity.z = math.radians(0.6), math.radians(0.5)
        message.orientation_covariance[0] = -1.0
        raw.publish(twist)
        imu.publish(message)
        time.sleep(0.0005)
    out, _ = process.communicate(timeout=30.0)
    found = json.loads(out)
    assert process.returncode == 0
    assert found["orientation_covariance_0"] == -1.0
    for name, rate in (("imu", 0.5), ("rate_raw", 0.6)):
        assert found[name]["duration_s"] == pytest.approx(20.0, abs=0.05)
        assert found[name]["yaw_deg"] == pytest.approx(rate * found[name]["duration_s"], rel=1e-9)


def test_demo_end_to_end(tmp_path, capfd, monkeypatch):
    """Real processes, service call, progress, table, page, JSON; a quick plan."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr("gyro_calib.cli.demo_session.LISTEN_S", 20.0)
    out, document = tmp_path / "out", tmp_path / "demo.json"
    arguments = ["demo", "--seed", "2", "--quality", "quick", "--speed", "15", "--out", str(out), "--json", str(document)]
    assert main(arguments) == 0, (out / "nodes.log").read_text()
    captured = capfd.readouterr()
    assert "Before and after" in captured.out
    assert "self-calibration: 50 %" in captured.err
    found = json.loads(document.read_text())
    assert found["seed"] == 2
    assert found["simulated_s"] > 110.0
    assert found["record_id"].startswith("ring_15k-0002-")
    for group in ("before", "after", "error"):
        for name, unit in (("bias", "deg/h"), ("scale_factor_error", "ppm")):
            assert found[group][name]["unit"] == unit
    assert abs(found["before"]["bias"]["value"]) > 50.0 * abs(found["after"]["bias"]["value"])
    for name in ("bias", "scale_factor_error", "rate"):
        assert abs(found["error"][name]["value"]) < 6.0 * found["error"][name]["sd"]
    assert found["error"]["bias"]["sd"] < 20.0
    page = (out / "report.html").read_text(encoding="utf-8")
    assert found["record_id"] in page
    assert page.count("<svg") == 8
    assert (out / "ros_home" / "gyro_calib" / "ring_15k-0002.yaml").is_file()


def test_demo_tells_why_it_failed(tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert main(["demo", "--out", str(tmp_path / "out"), "--speed", "-1"]) == 1
    error = capfd.readouterr().err
    assert "Node gyro_sim must keep running, but ended with exit code" in error
    assert "gyro_sim: " in error
