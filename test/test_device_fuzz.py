"""Damaged device descriptions: a DeviceError that says what is wrong, or a device that can be computed with."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyro_calib.device import Device, device_to_dict, draw_unit, dump_device, load_device
from gyro_calib.errors import DeviceError

FUZZ = settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
DEVICE = load_device("hrg_sun2024")
DOCUMENT = device_to_dict(DEVICE)
TEXT = yaml.safe_dump(DOCUMENT, sort_keys=False).encode()


def use(path: Path) -> Device | None:
    """The device, used as the simulator does; None when it was refused. Anything but a DeviceError fails the test."""
    try:
        device = load_device(path)
        draw_unit(device, 1)
    except DeviceError as error:
        message = str(error)
    else:
        flow = device.slow_flow(0.1)
        assert all(np.isfinite(part).all() for part in (flow.A, flow.G, flow.E))
        assert device.factory()
        return device
    assert len(message) > 20
    return None


@FUZZ
@given(data=st.binary(max_size=200))
def test_arbitrary_bytes_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "fuzz.yaml"
    path.write_bytes(data)
    assert use(path) is None


@FUZZ
@given(
    at=st.integers(0, len(TEXT) - 1),
    length=st.integers(0, 30),
    insert=st.one_of(st.binary(max_size=6), st.text("0123456789.eE-+:{}[]!&*?|>'\"\n#, abnul", max_size=10).map(str.encode)),
)
def test_a_text_that_is_damaged(tmp_path: Path, at: int, length: int, insert: bytes) -> None:
    path = tmp_path / "fuzz.yaml"
    path.write_bytes(TEXT[:at] + insert + TEXT[at + length :])
    use(path)


def places(content: dict[str, Any], at: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = []
    for key, value in content.items():
        found.append((*at, key))
        if isinstance(value, dict):
            found += places(value, (*at, key))
    return found


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.sampled_from([1e300, -1e300, 5e-324, 0.0, -1.0]),
    st.text(max_size=6),
    st.lists(st.floats(), max_size=3),
    st.dictionaries(st.text(max_size=4), st.floats(), max_size=3),
)


@FUZZ
@given(changes=st.dictionaries(st.sampled_from(places(DOCUMENT)), JUNK, min_size=1, max_size=2))
def test_values_that_are_junk(tmp_path: Path, changes: dict[tuple[str, ...], Any]) -> None:
    document = copy.deepcopy(DOCUMENT)
    for place, value in changes.items():
        inner: Any = document
        for key in place[:-1]:
            inner = inner.get(key, {}) if isinstance(inner, dict) else {}
        if isinstance(inner, dict):
            inner[place[-1]] = value
    path = tmp_path / "fuzz.yaml"
    path.write_text(yaml.safe_dump(document))
    use(path)


@pytest.mark.parametrize(
    "text",
    [
        "!!int x",
        "!!timestamp x",
        "a: 2024-99-99",
        "? [a]\n: 1",
        "[" * 5000,
        "{" * 5000,
        "1" * 5000,
        "!!python/name:os.system",
        "a: &x [1]\nb: *x",
    ],
    ids=lambda text: text[:12],
)
def test_nasty_yaml_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "nasty.yaml").write_text(text)
    with pytest.raises(DeviceError):
        load_device(tmp_path / "nasty.yaml")


def test_numbers_that_are_beyond_computing_are_refused(tmp_path: Path) -> None:
    document = copy.deepcopy(DOCUMENT)
    document["resonator"]["frequency_hz"] = 1e200
    document["electronics"]["adc_rate_hz"] = 1e202
    (tmp_path / "far.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(DeviceError, match="must have a finite slow flow"):
        load_device(tmp_path / "far.yaml")


def test_a_description_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "unit.yaml"
    dump_device(DEVICE, path)
    real = Path.write_text

    def full(target: Path, text: str, **options: Any) -> int:
        real(target, text[: len(text) // 2], **options)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(DeviceError, match="No space left"):
        dump_device(draw_unit(DEVICE, 3), path)
    assert load_device(path) == DEVICE
    assert [p.name for p in tmp_path.iterdir()] == ["unit.yaml"]
