"""Which record is applied to one gyro, if any, and why: the decisions of ``imu_corrector``, without ROS."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from ..calibration import CalibrationRecord, Corrector, CovarianceModel, RateErrorModel, validity_problems
from ..errors import DataError
from ..recording.rate import rate_range

__all__ = ["ERROR", "OK", "WARN", "CorrectionSettings", "CorrectionState"]

#: levels, as in diagnostic_msgs/DiagnosticStatus
OK, WARN, ERROR = 0, 1, 2

#: sample rate until the first two stamps are known [Hz]
_FIRST_GUESS_HZ = 1000.0
#: what nobody stated: share of the bias per kelvin (Q ~ 1/T is 0.34 %; 150 drawn rings: 0.33 %, with the bias by 0.97), gains per kelvin
_BIAS_PER_K, _SCALE_PER_K = 0.005, 150e-6
#: a raw rate beyond this is none of any gyro, whatever its driver says of its range [rad/s]
_FASTEST_RAD_S = 1e4


@dataclass(frozen=True)
class CorrectionSettings:
    """What the user asks for; parameters of the node, described there."""

    uncalibrated: RateErrorModel
    covariance_mode: str = "total"
    horizon_s: float = 60.0
    bandwidth_hz: float | None = None
    bias_drift_sd_rad_s: float = 0.0
    bias_temperature_sd_rad_s_per_k: float | None = None
    scale_factor_temperature_sd_per_k: float | None = None
    out_of_validity_sd_factor: float = 10.0
    hold_uncalibrated: bool = False
    rate_limit_rad_s: float = 0.0

    def bias_sd_per_k(self, record: CalibrationRecord) -> float:
        """Change of the bias per kelvin [rad/s/K], 1 sigma: as stated, or by the damping that most of a bias comes from."""
        stated = self.bias_temperature_sd_rad_s_per_k
        return _BIAS_PER_K * abs(record.bias.value) if stated is None else stated

    @property
    def scale_sd_per_k(self) -> float:
        """Change of the scale factor per kelvin [1/K], 1 sigma."""
        stated = self.scale_factor_temperature_sd_per_k
        return _SCALE_PER_K if stated is None else stated

    def covariance(self, sample_rate_hz: float) -> CovarianceModel:
        """The model for a sample rate."""
        return CovarianceModel(self.covariance_mode, sample_rate_hz, self.bandwidth_hz, self.horizon_s)


class CorrectionState:
    """Decides, for one gyro, how a raw rate becomes a rate.

    The outcome of :meth:`refresh` is plain numbers for the sample loop: ``rate = (raw - bias) * gain``, variance
    ``c0 + rate (c1 + c2 rate)``, ``publishing``, and the range beyond which a raw rate is no measurement.

    Parameters
    ----------
    settings : CorrectionSettings
        What the user asks for; may be replaced at any time.
    expected_device : str
        The device that the user says it is; "" when he does not.
    """

    def __init__(self, settings: CorrectionSettings, expected_device: str = "") -> None:
        self.settings = settings
        self.expected_device = expected_device
        self.reported_device = ""
        self.enabled = True
        self.record: CalibrationRecord | None = None
        self.source = ""
        #: why the last record that was offered is not used; "" when it is
        self.refusal = ""
        #: what is to be known about the source of the record
        self.note = ""
        #: nodes that publish the raw rate and correct it themselves
        self.upstream: tuple[str, ...] = ()
        self.temperature_degc: float | None = None
        self.mode: str | None = None
        self.excitation: str | None = None
        self.compensation: tuple[float, ...] | None = None
        self.range_rad_s = _FASTEST_RAD_S
        self._factory: Mapping[str, Any] = {}
        self._amplitude_v = 1.0
        self.sample_rate_hz = _FIRST_GUESS_HZ
        self.bias, self.gain = 0.0, 1.0
        self.c0, self.c1, self.c2 = 0.0, 0.0, 0.0
        self.publishing, self.corrected = False, False
        self.level, self.text = WARN, ""
        self.refresh(None)

    @property
    def device_id(self) -> str:
        """The device as far as it is known; "" when it is not."""
        return self.reported_device or self.expected_device

    def offer(self, record: CalibrationRecord, source: str) -> bool:
        """Take ``record`` into force, unless it belongs to another device; the one in force stays then."""
        if self.device_id:
            try:
                Corrector(record, device_id=self.device_id)
            except DataError as error:
                self.refusal = f"{source}: {error}"
                return False
        self.record, self.source, self.refusal, self.note = record, source, "", ""
        return True

    def identify(self, device_id: str) -> None:
        """The gyro says who it is; a record of another device goes out of force."""
        self.reported_device = device_id
        if self.record is not None and self.record.device_id != device_id:
            record, self.record = self.record, None
            self.offer(record, self.source)

    def learn_range(self, factory_json: object, amplitude_v: object) -> None:
        """How far the gyro measures, from what its driver says (either may be unknown, None); takes effect with :meth:`refresh`."""
        if isinstance(factory_json, str):
            with contextlib.suppress(ValueError, RecursionError):
                found = json.loads(factory_json)
                self._factory = found if isinstance(found, Mapping) else {}
        if isinstance(amplitude_v, float):
            self._amplitude_v = amplitude_v

    def refresh(self, now: datetime | None) -> None:
        """Decide anew; call it after anything changed, and from time to time because records age."""
        problems: list[tuple[int, str]] = [(ERROR, self.refusal)] if self.refusal else []
        blocked = self._upstream_problem()
        why_not = "" if blocked else self._why_not_corrected()
        record = None if blocked or why_not else self.record
        covariance = self.settings.covariance(self.sample_rate_hz)
        stated = self.settings.rate_limit_rad_s or rate_range(self.mode or "", self._amplitude_v, self._factory)
        self.range_rad_s = min(stated, _FASTEST_RAD_S)
        if record is None:
            errors = self.settings.uncalibrated
        else:
            doubts = self._doubts(record, now)
            problems += [(WARN, doubt) for doubt in doubts]
            away_k = 0.0 if self.temperature_degc is None else abs(self.temperature_degc - record.temperature_degc.value)
            # a thermometer that says nothing is a doubt already
            away_k = away_k if math.isfinite(away_k) else 0.0
            errors = RateErrorModel.from_record(
                record,
                bias_drift_sd_rad_s=math.hypot(self.settings.bias_drift_sd_rad_s, self.settings.bias_sd_per_k(record) * away_k),
                scale_factor_drift_sd=self.settings.scale_sd_per_k * away_k,
                sd_factor=self.settings.out_of_validity_sd_factor if doubts else 1.0,
            )
            if not self.device_id:
                problems.append((WARN, "Device not verified: the gyro does not say who it is; set device_ids."))
        if blocked:
            problems.append((ERROR, blocked))
        elif why_not:
            held = self.settings.hold_uncalibrated
            problems.append((ERROR, f"Held: {why_not}") if held else (WARN, f"Uncorrected: {why_not}"))
        self.bias, self.gain = errors.bias_rad_s, 1.0 / errors.scale_factor
        self.c0, self.c1, self.c2 = errors.variance_coefficients(covariance)
        self.corrected = record is not None
        self.publishing = not blocked and (self.corrected or not self.settings.hold_uncalibrated)
        self._say(problems, record)

    def _upstream_problem(self) -> str:
        if not self.upstream:
            return ""
        return f"Input must be a raw rate, but {', '.join(self.upstream)} corrected it already. Subscribe to the gyro itself."

    def _why_not_corrected(self) -> str:
        if not self.enabled:
            return "correction is switched off; call ~/enable."
        if self.expected_device and self.reported_device and self.expected_device != self.reported_device:
            return f"device_ids says {self.expected_device!r}, but the gyro says {self.reported_device!r}; correct one of them."
        if self.record is None:
            return "there is no calibration record; calibrate, or set record_urls."
        if self.excitation not in (None, "none"):
            return f"the gyro is excited ({self.excitation}), its rate carries that; wait until the run ends."
        return " ".join(validity_problems(self.record, mode=self.mode, compensation=self.compensation))

    def _doubts(self, record: CalibrationRecord, now: datetime | None) -> Sequence[str]:
        return validity_problems(record, temperature_degc=self.temperature_degc, now=now)

    def _say(self, problems: list[tuple[int, str]], record: CalibrationRecord | None) -> None:
        self.level = max((level for level, _ in problems), default=OK)
        if record is not None:
            problems.insert(0, (OK, f"Corrected by {record.record_id}."))
        if self.note:
            problems.append((WARN, self.note))
            self.level = max(self.level, WARN)
        self.text = " ".join(text for _, text in problems)
