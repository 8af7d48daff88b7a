"""The record refuses what could not be applied safely, and round-trips exactly through plain types and text."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import datetime, timezone
from itertools import pairwise

import numpy as np
import pytest
import yaml
from calibration_samples import make_record
from hypothesis import given
from hypothesis import strategies as st

from gyro_calib.calibration import CalibrationRecord, dump_record, parse_record
from gyro_calib.errors import DataError, StoreError
from gyro_calib.quantity import Quantity

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


def test_dict_round_trip_is_exact() -> None:
    record = make_record()
    again = CalibrationRecord.from_dict(json.loads(json.dumps(record.to_dict(), allow_nan=False)))
    assert again.to_dict() == record.to_dict()
    assert again.bias == record.bias
    assert again.parameters["pickoff_phase"].sd == math.inf
    assert math.isnan(again.condition_number)
    assert again.content_hash == record.content_hash


@given(bias=finite, k=finite.filter(lambda x: x != 0.0), sd=st.floats(0.0, 1e300), text=st.text(max_size=30))
def test_document_round_trip_is_exact_for_any_number_and_text(bias: float, k: float, sd: float, text: str) -> None:
    record = make_record(
        bias=Quantity(bias, sd, "rad/s"),
        scale_factor=Quantity(k, 0.0, "1"),
        bias_scale_covariance=0.0,
        provenance={"note": text, text: [bias, 0, None, True]},
    )
    again = parse_record(dump_record(record))
    assert again.to_dict() == record.to_dict()
    assert math.copysign(1.0, again.bias.value) == math.copysign(1.0, bias)


def test_id_names_device_time_and_content() -> None:
    record = make_record()
    assert record.record_id == f"ring_15k-0007-20260301T120000Z-{record.content_hash[:8]}"
    assert replace(record, record_id="other").content_hash == record.content_hash
    assert make_record(method="factory").content_hash != record.content_hash


def test_time_is_read_with_and_without_a_zone() -> None:
    noon = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
    for text in ("2026-03-01T12:00:00Z", "2026-03-01T12:00:00", "2026-03-01T14:00:00+02:00"):
        assert make_record(created_utc=text).created == noon


def test_numpy_values_become_plain() -> None:
    record = make_record(
        bias=Quantity(np.float64(1e-3), np.float64(1e-6), "rad/s"),  # type: ignore[arg-type]
        compensation=np.eye(2).ravel(),  # type: ignore[arg-type]
        provenance={"count": np.int64(3), "shape": np.array([1.0, 2.0]), "bad": np.nan},
    )
    assert type(record.bias.value) is float
    assert record.compensation == (1.0, 0.0, 0.0, 1.0)
    assert record.provenance == {"count": 3, "shape": [1.0, 2.0], "bad": None}
    assert parse_record(dump_record(record)).to_dict() == record.to_dict()


def test_limits_that_are_not_finite_set_no_limit() -> None:
    assert make_record(validity={"max_age_s": math.inf, "temperature_min_degc": 1}).validity == {"temperature_min_degc": 1.0}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"device_id": ""}, "device_id must be a text"),
        ({"record_id": "a\nb"}, "record_id must be a text"),
        ({"created_utc": "yesterday"}, "created_utc must be an ISO 8601 time, but got 'yesterday'"),
        ({"schema_version": 2}, "schema_version must be 1, but got 2"),
        ({"bias": Quantity(1.0, 0.1, "deg/h")}, "bias must be in 'rad/s', but got 'deg/h'"),
        ({"bias": Quantity(math.nan, 0.1, "rad/s")}, "bias must be finite"),
        ({"bias": Quantity(0.0, math.inf, "rad/s")}, "bias must have a finite sd"),
        ({"bias": 1.0}, "bias must be a Quantity, but got float"),
        ({"scale_factor": Quantity(0.0, 0.1, "1")}, "scale_factor must not be 0"),
        ({"rate_noise_density": Quantity(-1.0, 0.1, "rad/s/sqrt(Hz)")}, "rate_noise_density must be >= 0"),
        ({"bias_scale_covariance": 1.0}, "bias_scale_covariance must lie within"),
        ({"bias_scale_covariance": math.nan}, "bias_scale_covariance must lie within"),
        ({"bias_by_axis": {"z": Quantity(0.0, 0.1, "rad/s")}}, "bias_by_axis must have the keys x and y"),
        ({"compensation": (1.0, 0.0, 0.0)}, "compensation must be 4 finite numbers"),
        ({"validity": {"temperature_min_degc": 2.0, "temperature_max_degc": 1.0}}, "temperature_min_degc must be <="),
        ({"validity": {"max_age_s": 0.0}}, "max_age_s must be > 0"),
        ({"operating_point": {"amplitude_v": "1"}}, "operating_point amplitude_v must be a number"),
        ({"warnings": "one text"}, "warnings must be a list of texts"),
        ({"provenance": {"object": object()}}, "provenance.object must be made of"),
    ],
)
def test_what_cannot_be_applied_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        make_record(**changes)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda d: d.pop("bias"), "must have the field bias"),
        (lambda d: d.pop("method"), "must be of their types"),
        (lambda d: d.update(extra=1), "must be of schema 1, but got extra"),
        (lambda d: d.update(bias=3), "bias must be {value, sd, unit}"),
        (lambda d: d["bias"].update(value="3"), "bias must have numbers"),
        (lambda d: d["bias"].update(sd=-1.0), "must be of their types"),
        (lambda d: d.update(parameters=[1]), "parameters must be a mapping"),
        (lambda d: d.update(compensation=None), "must be of their types"),
    ],
)
def test_from_dict_names_the_field(edit, message: str) -> None:
    data = make_record().to_dict()
    edit(data)
    with pytest.raises(DataError, match=message):
        CalibrationRecord.from_dict(data)


def test_document_survives_reformatting_but_not_edits() -> None:
    record = make_record()
    document = yaml.safe_load(dump_record(record))
    assert parse_record("# another header\n" + yaml.safe_dump(document)).to_dict() == record.to_dict()
    document["record"]["bias"]["value"] *= 1.0 + 1e-15
    with pytest.raises(StoreError, match=r"must have the checksum of its content.*torn or was edited"):
        parse_record(yaml.safe_dump(document))


def test_document_of_many_aliases_is_refused_quickly() -> None:
    names = "abcdefghijklmnop"
    bomb = "a: &a [1,1]\n" + "".join(f"{c}: &{c} [*{p},*{p},*{p},*{p}]\n" for p, c in pairwise(names))
    with pytest.raises(StoreError, match="aliases are not allowed"):
        parse_record(bomb)
