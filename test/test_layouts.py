"""Layouts of PlotJuggler and Foxglove: well formed, and every topic, field and service that they name is one of the nodes'."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PLOTJUGGLER = sorted((ROOT / "config" / "plotjuggler").glob("*.xml"))
FOXGLOVE = sorted((ROOT / "config" / "foxglove").glob("*.json"))


def xml(path: Path) -> Any:
    return ElementTree.parse(path).getroot()


def panels(layout: Any) -> Iterator[str]:
    """Panels that a Foxglove layout places."""
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column")
        assert 0 < layout["splitPercentage"] < 100
        yield from panels(layout["first"])
        yield from panels(layout["second"])


def foxglove_paths(document: Any) -> set[str]:
    """Message paths: a topic, or a topic with a field after a full stop."""
    found = set()
    for panel in document["configById"].values():
        found |= {line["value"] for line in panel.get("paths", ())}
        found |= {panel[key] for key in ("path", "topicPath", "topicToRender") if panel.get(key)}
    return found


def test_there_are_layouts() -> None:
    assert PLOTJUGGLER
    assert FOXGLOVE


@pytest.mark.parametrize("path", PLOTJUGGLER, ids=lambda p: p.name)
def test_plotjuggler_layout_is_whole(path: Path) -> None:
    root = xml(path)
    made = {snippet.get("name") for snippet in root.iter("snippet")}
    chosen = {topic.get("name") for topic in root.iter("topic")}
    for splitter in root.iter("DockSplitter"):
        assert int(splitter.get("count")) == len(splitter) == len(splitter.get("sizes").split(";"))
    for area in root.iter("DockArea"):
        # a plot has a title, and what is not a flag has a unit in it
        assert area.get("name")
    for curve in root.iter("curve"):
        name = curve.get("name")
        assert name in made or any(name.startswith(f"{topic}/") for topic in chosen), name
        assert re.fullmatch(r"#[0-9a-f]{6}", curve.get("color"))
    for snippet in root.iter("snippet"):
        assert "[deg/h]" in snippet.get("name")
        # deg/h of one rad/s
        factor = float(re.search(r"value \* ([\d.]+)", snippet.findtext("function"))[1])
        assert factor == pytest.approx(180.0 / 3.14159265359 * 3600.0)


@pytest.mark.parametrize("path", FOXGLOVE, ids=lambda p: p.name)
def test_foxglove_layout_is_whole(path: Path) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    placed = list(panels(document["layout"]))
    assert sorted(placed) == sorted(document["configById"])  # each once
    for name, panel in document["configById"].items():
        if name.startswith("Plot!"):
            assert "[" in panel["title"], name  # a unit
            assert all(line["label"] for line in panel["paths"])


@pytest.mark.ros
def test_every_name_is_one_of_the_nodes(ros: Any) -> None:
    from gyro_calib.nodes.calibration_node import CalibrationNode
    from gyro_calib.nodes.gyro_sim_node import GyroSimNode
    from gyro_calib.nodes.imu_corrector_node import ImuCorrector

    nodes = [ros.add(kind(namespace="/gyro")) for kind in (GyroSimNode, CalibrationNode, ImuCorrector)]
    topics = {end.topic_name: end.msg_type for node in nodes for end in (*node.publishers, *node.subscriptions)}
    services = {node.resolve_service_name(service.srv_name) for node in nodes for service in node.services}

    paths = {tuple(p.partition(".")[::2]) for file in FOXGLOVE for p in foxglove_paths(json.loads(file.read_text(encoding="utf-8")))}
    for file in PLOTJUGGLER:
        root = xml(file)
        chosen = [topic.get("name") for topic in root.iter("topic")]
        paths |= {(topic, "") for topic in chosen}
        made = {snippet.get("name") for snippet in root.iter("snippet")}
        series = {c.get("name") for c in root.iter("curve")} - made | {s.findtext("linked_source") for s in root.iter("snippet")}
        for name in series:
            topic = max((t for t in chosen if name.startswith(f"{t}/")), key=len)
            paths.add((topic, name.removeprefix(f"{topic}/").replace("/", ".")))
    assert len(paths) > 10
    for topic, field in sorted(paths):
        assert topic in topics, f"no node has the topic {topic}"
        assert has_field(topics[topic], field), f"{topic} has no field {field}"
    called = {
        panel["serviceName"]
        for file in FOXGLOVE
        for panel in json.loads(file.read_text(encoding="utf-8"))["configById"].values()
        if "serviceName" in panel
    }
    assert called <= services
    assert called


def has_field(kind: Any, path: str) -> bool:
    """Whether a message type has the field ``a.b.c`` or ``a.b[3]``."""
    for part in path.split(".") if path else ():
        name, _, index = part.rstrip("]").partition("[")
        typed = kind.get_fields_and_field_types().get(name)
        if typed is None:
            return False
        if index:
            return bool(re.match(r"(double|float)\[(\d+)\]", typed)) and int(index) < int(re.search(r"\[(\d+)\]", typed)[1])
        if "/" in typed:
            package, _, message = typed.partition("/")
            kind = getattr(importlib.import_module(f"{package}.msg"), message)
    return True
