"""Coercion of record fields to plain Python types, with errors that name the field."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..errors import DataError
from ..quantity import Quantity

__all__ = ["float_map", "plain", "quantity", "quantity_map", "text"]


def text(what: str, value: object) -> str:
    """``value`` if it is a text with something in it and no control characters.

    Raises
    ------
    DataError
        It is not; the text names ``what``.
    """
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise DataError(f"{what} must be a text of printable characters, but got {value!r}.")
    return value


def quantity(what: str, value: object) -> Quantity:
    """``value`` as a :class:`Quantity`; mappings ``{"value", "sd", "unit"}`` are converted, numpy scalars become floats.

    Raises
    ------
    DataError
        It is neither; the text names ``what``.
    """
    if isinstance(value, Quantity):
        return Quantity(float(value.value), float(value.sd), value.unit)
    if not isinstance(value, Mapping) or not {"value", "unit"} <= set(value):
        raise DataError(f"{what} must be {{value, sd, unit}}, but got {value!r}.")
    if any(isinstance(value.get(key), (str, bool)) for key in ("value", "sd")):
        raise DataError(f"{what} must have numbers as value and sd, but got {value!r}.")
    return Quantity.from_json(value)


def quantity_map(what: str, value: object) -> dict[str, Quantity]:
    """Mapping of text to :class:`Quantity`.

    Raises
    ------
    DataError
        It is not; the text names ``what`` and the key.
    """
    if not isinstance(value, Mapping):
        raise DataError(f"{what} must be a mapping of quantities, but got {value!r}.")
    return {text(f"Key of {what}", k): quantity(f"{what} {k}", v) for k, v in value.items()}


def float_map(what: str, value: object) -> dict[str, float]:
    """Mapping of text to float; ``None`` reads as NaN, infinities become NaN.

    Raises
    ------
    DataError
        It is not; the text names ``what`` and the key.
    """
    if not isinstance(value, Mapping):
        raise DataError(f"{what} must be a mapping of numbers, but got {value!r}.")
    out = {}
    for key, number in value.items():
        if isinstance(number, (str, bool)):
            raise DataError(f"{what} {key} must be a number, but got {number!r}.")
        as_float = math.nan if number is None else float(number)
        out[text(f"Key of {what}", key)] = as_float if math.isfinite(as_float) else math.nan
    return out


def plain(what: str, value: Any) -> Any:
    """``value`` made of dict, list, text, bool, int, finite float and None only; numpy scalars and arrays are converted.

    Raises
    ------
    DataError
        It holds something else; the text names ``what``.
    """
    if hasattr(value, "tolist"):  # numpy scalar or array, without importing numpy here
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, Mapping):
        return {str(k): plain(f"{what}.{k}", v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(f"{what}[{i}]", v) for i, v in enumerate(value)]
    raise DataError(f"{what} must be made of texts, numbers, lists and mappings, but got {type(value).__name__}. Convert it to text.")
