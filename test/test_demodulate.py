"""Raw carrier-rate recordings: the own digital PLL and I/Q against the demodulated path, of the simulator and of another plant."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from bench_data import BENCH, needs_bench
from numpy.typing import NDArray

from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError, DeviceError
from gyro_calib.recording import Campaign, load_campaign, write_campaign_h5
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.decimation import RowGrid, cascade, decimate
from gyro_calib.recording.demodulate import demodulate
from gyro_calib.recording.phase_lock import is_phase, lock_phase
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator

SIDE_BAND = Command("ftr_x", Excitation("amplitude_modulation", 1.5, 0.15))
FACTORY = load_device("ring_15k").factory()


def _captured(command: Command, *, noisy: bool = True, seconds: float = 0.3) -> Recording:
    simulator = GyroSimulator(draw_unit(load_device("ring_15k"), 3), rng=np.random.default_rng(1), noisy=noisy)
    simulator.configure(command)
    simulator.advance(3.0)
    capture = simulator.capture_raw(seconds, 0.01)
    extras = {"dac_zero_order_hold_s": simulator.factory["dac_zero_order_hold_s"]}
    return Recording(simulator.device_id, capture.rows, command, simulator.sample_rate_hz, "captured", extras, capture.raw)


@pytest.fixture(scope="module")
def captured() -> Recording:
    return _captured(SIDE_BAND)


def _voltage(raw: dict[str, Any], noise_v: float = 0.0) -> NDArray[np.float64]:
    """A reference as a board gives it: harmonics, a tenth of amplitude modulation, noise."""
    phase, t = raw["phase_ref"], raw["t"]
    wave = np.cos(phase) + 0.1 * np.cos(2 * phase + 0.3) + 0.05 * np.cos(3 * phase + 1.0)
    return np.asarray((1 + 0.1 * np.sin(2 * np.pi * 40 * t)) * wave + noise_v * np.random.default_rng(0).standard_normal(t.size))


def _with(recording: Recording, **channels: Any) -> Recording:
    raw = {k: v for k, v in {**(recording.raw or {}), **channels}.items() if v is not None}
    return replace(recording, raw=raw)


def _differences(found: Recording, wanted: Recording) -> NDArray[np.float64]:
    """Rows found minus rows wanted at the same times, columns from x_pick_c on."""
    at = np.searchsorted(wanted.t, found.t - 1e-5)
    np.testing.assert_allclose(found.t, wanted.t[at], atol=1e-9)
    return np.asarray(found.data[:, 2:] - wanted.data[at, 2:])


@pytest.mark.parametrize(
    "command",
    [Command(), Command("ftr_y"), SIDE_BAND, Command("loops_off", Excitation("drive", 14950.0, volts=2.0, axis="y"))],
    ids=["ftr_x", "ftr_y", "side band", "open drive"],
)
def test_noise_free_rows_equal_the_simulators_own(command: Command) -> None:
    recording = _captured(command, noisy=False)
    found = demodulate(recording)
    assert len(found) > 100
    assert found.raw is None
    worst = np.abs(_differences(found, recording)).max(axis=0)
    assert worst[:4].max() < 1e-8  # V
    assert worst[4:8].max() < 2e-5  # V: a drive that changes from control step to control step has images of the carrier
    assert worst[8] < 1e-6  # Hz
    assert worst[9] < 1e-3  # K


def test_a_reference_voltage_with_harmonics_and_amplitude_modulation_gives_the_same_rows() -> None:
    recording = _captured(SIDE_BAND, noisy=False)
    found = demodulate(_with(recording, phase_ref=_voltage(dict(recording.raw or {}))), factory=FACTORY)
    assert found.extras["demodulation"]["reference"] == "phase_ref [V]"
    worst = np.abs(_differences(found, recording)).max(axis=0)
    assert worst[:4].max() < 1e-6
    assert worst[4:8].max() < 2e-5
    assert worst[8] < 1e-4


def test_a_noisy_reference_and_the_pick_off_fallback_agree_within_their_phase_noise(captured: Recording) -> None:
    raw = dict(captured.raw or {})
    for phase_ref in (_voltage(raw, 1e-3), None):
        found = demodulate(_with(captured, phase_ref=phase_ref), factory=FACTORY)
        difference = _differences(found, captured)
        # a phase error turns every envelope alike: taken back, nothing is left
        turn = np.unwrap(np.angle(found.pick[:, 0])) - np.angle(captured.pick[np.searchsorted(captured.t, found.t - 1e-5), 0])
        assert np.abs(turn).max() < 5e-4
        drive = found.drive * np.exp(-1j * turn)[:, None]
        wanted = captured.drive[np.searchsorted(captured.t, found.t - 1e-5)]
        assert np.abs(drive - wanted).max() < 3e-5
        assert abs(difference[:, 0].mean()) < 1e-6
        assert np.abs(difference[:, 8]).max() < 0.02
    assert found.extras["demodulation"]["reference"] == "x_pick [V]"


def test_a_sine_or_inverted_reference_is_turned_to_the_pick_offs_cosine(captured: Recording) -> None:
    phase = (captured.raw or {})["phase_ref"]
    for wave, quarters in ((np.sin(phase), 1), (-np.cos(phase), 2), (-np.sin(phase), 3)):
        found = demodulate(_with(captured, phase_ref=wave), factory=FACTORY)
        assert found.extras["demodulation"]["reference_quarter_turns"] == quarters
        assert np.abs(_differences(found, captured)[:, :4]).max() < 2e-5
        assert np.abs(_differences(found, captured)[:, 4:8]).max() < 5e-5


def test_a_held_drive_is_late_by_half_its_hold(captured: Recording) -> None:
    omega = 2 * np.pi * captured.column("ref_freq").mean()
    hold = captured.extras["dac_zero_order_hold_s"]
    as_smooth = demodulate(replace(captured, extras={}))
    as_held = demodulate(captured)
    late = np.angle((as_smooth.drive[:, 0] / as_held.drive[:, 0]).mean())
    assert late == pytest.approx(0.5 * omega * hold, rel=1e-3)
    stated = demodulate(replace(captured, extras={**captured.extras, "firmware_drive_phase_advance_rad": 0.5 * omega * hold}))
    np.testing.assert_allclose(stated.drive, as_held.drive, atol=1e-5)
    from_factory = demodulate(replace(captured, extras={}), factory=FACTORY)
    np.testing.assert_array_equal(from_factory.drive, as_held.drive)


def test_a_hold_of_several_samples_is_taken_back_whole(captured: Recording) -> None:
    raw = dict(captured.raw or {})
    phase, rate = raw["phase_ref"], 240e3
    step = float(np.median(np.diff(np.unwrap(phase))))
    command = np.exp(1j * (phase + 2.0 * step))  # of 2 V/2, advanced by half of four samples
    held = np.repeat(command[::4].real, 4)[: phase.size]
    extras = {"dac_zero_order_hold_s": 4 / rate}
    found = demodulate(_with(replace(captured, extras=extras), x_drive=held))
    np.testing.assert_allclose(found.drive[:, 0].mean(), 1.0, atol=2e-3)


def test_the_phase_lock_follows_a_moving_carrier_without_lag() -> None:
    rate = 100e3
    t = np.arange(60_000) / rate
    truth = 2 * np.pi * (9000.0 * t + 3.0 * t**2) + 0.02 * np.sin(2 * np.pi * 15.0 * t)
    phase, margin = lock_phase((1 + 0.3 * np.sin(2 * np.pi * 7 * t)) * np.cos(truth), rate)
    inner = slice(2 * margin, t.size - 2 * margin)
    error = np.angle(np.exp(1j * (phase - truth)))[inner]
    assert np.abs(error).max() < 1e-4


def test_phase_and_voltage_are_told_apart() -> None:
    t = np.arange(5000) / 240e3
    phase = 2 * np.pi * 15e3 * t
    assert is_phase(phase)
    assert is_phase((phase + 1.0) % (2 * np.pi) - np.pi)
    for amplitude in (1e-3, 1.0, 5.0, 20.0):
        assert not is_phase(amplitude * np.cos(phase))
    assert not is_phase(np.zeros(5000))
    assert not is_phase(np.random.default_rng(0).standard_normal(5000))


def test_decimation_is_the_cascade_at_its_centre() -> None:
    samples = np.random.default_rng(0).standard_normal(500)
    for order, length in ((1, 7), (3, 8), (4, 5)):
        grid = RowGrid.within(11, 480, length, order)
        taps = cascade(length, order)
        assert taps.sum() == pytest.approx(1.0)
        direct = [taps @ samples[grid.first + k * length :][: grid.span] for k in range(grid.count)]
        np.testing.assert_allclose(decimate(samples, grid), direct, rtol=1e-12)
        np.testing.assert_allclose(decimate(np.arange(500.0), grid), grid.centres, rtol=1e-12)
        assert grid.first + grid.span + (grid.count - 1) * length <= 480


@needs_bench
@pytest.mark.parametrize("name", ["ring_a", "ring_b", "hrg_a", "hrg_b"])
def test_another_plants_raw_block_gives_the_rows_of_its_own_logger(name: str) -> None:
    """Its filter is a cascade of four boxcars; the drive columns are the commanded ones, the raw drive the converter's."""
    campaign = load_campaign(BENCH / f"{name}.h5", check=False)
    raw = [r for r in campaign if r.raw is not None]
    assert raw
    for recording in raw:
        found = demodulate(recording, order=4, factory=campaign.factory)
        assert len(found) > 10
        difference = _differences(found, recording)
        assert np.abs(difference[:, :4]).max() < 3e-5
        assert np.abs(difference[:, 4:8]).max() < 1e-4
        assert np.abs(difference[:, 4:8].mean(axis=0)).max() < 5e-6
        assert np.abs(difference[:, 8]).max() < 2e-5
        # the pick-off that oscillates, by its logger's own phase: to the file's single precision
        loudest = int(np.argmax(np.abs(recording.pick).mean(axis=0)))
        assert np.abs(difference[:, 2 * loudest]).max() < 2e-7


def test_files_of_raw_samples_alone_are_demodulated_as_they_are_read(tmp_path: Path, captured: Recording) -> None:
    alone = replace(captured, data=np.empty((0, 12)), sample_rate_hz=240e3)
    path = write_campaign_h5(tmp_path / "raw.h5", Campaign(captured.device_id, (alone,), FACTORY))
    found = load_campaign(path).recordings[0]
    assert found.sample_rate_hz == pytest.approx(500.0)
    assert found.command == captured.command
    wanted = demodulate(captured)
    np.testing.assert_allclose(found.pick.mean(axis=0), wanted.pick.mean(axis=0), atol=2e-4)

    plain = tmp_path / "stranger.h5"
    with h5py.File(plain, "w") as file:
        file.attrs["device_id"], file.attrs["factory"] = "u", json.dumps(FACTORY)
        group = file.create_group("run_1")
        group.attrs["mode"], group.attrs["temperature_degC"], group.attrs["sample_rate_hz"] = "ftr_x", 26.5, 1000.0
        for name, values in (captured.raw or {}).items():
            group[name] = values
    found = load_campaign(plain).recordings[0]
    assert found.sample_rate_hz == pytest.approx(1000.0)
    np.testing.assert_allclose(found.temperature_degc, 26.5)
    np.testing.assert_allclose(found.drive.mean(axis=0), wanted.drive.mean(axis=0), atol=2e-3)


def test_an_unstated_temperature_is_assumed_aloud_or_refused(captured: Recording, caplog: pytest.LogCaptureFixture) -> None:
    alone = replace(captured, data=np.empty((0, 12)), sample_rate_hz=240e3)
    assert demodulate(alone, factory=FACTORY).temperature_degc[0] == 25.0
    assert "states no temperature" in caplog.text
    with pytest.raises(DataError, match="Add the attribute"):
        demodulate(alone)
    with_channel = _with(alone, temperature=np.full(captured.raw["t"].size, 31.0))  # type: ignore[index]
    np.testing.assert_allclose(demodulate(with_channel).temperature_degc, 31.0)


def test_what_cannot_be_demodulated_is_refused_with_its_reason(captured: Recording) -> None:
    raw = dict(captured.raw or {})
    size = raw["t"].size
    noise = np.random.default_rng(0).standard_normal(size)
    broken = raw["x_pick"].copy()
    broken[77] = np.nan
    gap = raw["t"].copy()
    gap[5000:] += 1e-3
    fading = np.cos(raw["phase_ref"]) * (np.abs(np.arange(size) - size // 2) > 5000)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"y_drive": None}, "lacks y_drive"),
        ({"x_pick": broken}, "nan at sample 77"),
        ({"x_pick": raw["x_pick"][:-1]}, "shape"),
        ({"t": gap}, r"before sample 5000 .* missing or repeated"),
        ({"t": raw["t"][::-1]}, "must increase"),
        ({"phase_ref": noise}, "must hold a carrier within 10 %"),
        ({"phase_ref": np.zeros(size)}, "must hold a carrier"),
        ({"phase_ref": fading}, "must not fade"),
        ({"x_pick": 1e-6 * noise}, "must hold a carrier"),
    ]
    for channels, message in cases:
        with pytest.raises(DataError, match=message):
            demodulate(_with(captured, **channels), factory=FACTORY)
    slow = {k: v[::5] for k, v in raw.items()}
    for reference in (slow["phase_ref"], np.cos(slow["phase_ref"])):
        with pytest.raises(DataError, match="samples per carrier cycle"):
            demodulate(replace(captured, raw={**slow, "phase_ref": reference}))
    short = {k: v[:1000] for k, v in raw.items()}
    with pytest.raises(DataError, match="for two rows"):
        demodulate(replace(captured, raw=short))
    brief = {k: v[:300] for k, v in raw.items()} | {"phase_ref": np.cos(raw["phase_ref"][:300])}
    with pytest.raises(DataError, match="must last at least"):
        demodulate(replace(captured, raw=brief))
    with pytest.raises(DataError, match="64 samples"):
        demodulate(replace(captured, raw={k: v[:10] for k, v in raw.items()}))
    with pytest.raises(DataError, match="must hold t"):
        demodulate(replace(captured, raw=None))
    with pytest.raises(DataError, match="reference must be"):
        demodulate(captured, reference="z_pick")
    with pytest.raises(DataError, match="Row rate"):
        demodulate(captured, row_rate_hz=-1.0)


def test_the_slow_flow_has_no_converter_samples() -> None:
    simulator = GyroSimulator(load_device("ring_15k"), rng=np.random.default_rng(0), fidelity="slow_flow")
    with pytest.raises(DeviceError, match="'carrier'"):
        simulator.capture_raw(0.1)


def test_capturing_does_not_change_what_is_simulated() -> None:
    one, other = (GyroSimulator(load_device("ring_15k"), rng=np.random.default_rng(7)) for _ in range(2))
    rows = one.advance(0.4, 0.02)
    first = other.advance(0.2, 0.02)
    capture = other.capture_raw(0.2, 0.02)
    np.testing.assert_array_equal(rows, np.concatenate([first, capture.rows]))
    assert capture.raw["t"][0] == pytest.approx(0.2)
