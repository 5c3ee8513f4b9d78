"""Parse many decimal numbers at once; each value is the float nearest to its digits, as float() returns it."""

import json
from typing import NamedTuple

import numpy as np

from ..records import Array

POWER = b"\x01"
"""Replaces the e of an exponent and counts as a number's character; JSON contains no such byte."""

_MOST_WHOLE = 19
"""Digits before the point that are searched for it."""

_LARGEST = 8e18
"""Mantissas below this fit 64 bits."""

_TENS = 10 ** np.arange(19, dtype=np.int64)
_SIZES = 10.0 ** np.arange(25)
_POWERS = np.array([float(10**k) for k in range(23)])
"""Powers of ten that are floats exactly."""

_SPLIT = 2.0**27 + 1
"""Splits a float into halves whose products are exact: Dekker, Numerische Mathematik 18 (1971)."""

_HIGH = _SPLIT * _POWERS - (_SPLIT * _POWERS - _POWERS)
_MARGIN = 2.0**-90
"""Bounds the error of a remainder relative to its quotient: it is a few rounding errors of 2**-105."""

_MASKS = np.array([(2**64 - 1) >> (8 * (8 - n)) << (8 * (8 - n)) for n in range(9)], np.uint64)
_NIBBLES, _DIGIT = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x3030303030303030)
_PAIRS = ((2561, 8, 0x00FF00FF00FF00FF), (6553601, 16, 0x0000FFFF0000FFFF), (42949672960001, 32, 0xFFFFFFFF))
_STEPS = tuple(tuple(map(np.uint64, step)) for step in _PAIRS)


class _Decimals(NamedTuple):
    """Numbers mantissa / 10**scale (N,), with their sign · which are whole · which are read completely."""

    mantissa: Array
    scale: Array
    minus: Array
    whole: Array
    sure: Array


def numbers(content: bytes | bytearray, starts: Array, ends: Array) -> Array | None:
    """The marked numbers (N,) from bytes `starts` (N,) to `ends` (N,), int64 if all are whole, else float64.

    None if one is no JSON number or exceeds 64 bits.
    """
    read = _read(content, starts, ends)
    if read.sure.all() and read.whole.all():
        return np.where(read.minus, -read.mantissa, read.mantissa)
    values, near = _quotients(read)
    sure = read.sure & near
    rest = np.flatnonzero(~sure)
    if not len(rest):
        return values
    further = _one_by_one(content, starts[rest], ends[rest])
    if further is None or (further.dtype == np.int64 and read.whole[sure].all()):
        return _one_by_one(content, starts, ends)
    values[rest] = further
    return values


def _read(content: bytes | bytearray, starts: Array, ends: Array) -> _Decimals:
    """Mantissas and scales; of numbers with other than 1 to 24 digits after the point some are not sure."""
    letters, words = np.frombuffer(content, np.uint8), np.ndarray(len(content) - 7, "<u8", content, strides=(1,))
    minus = letters[starts] == ord("-")
    first = starts + minus
    exponent, last, sure = _exponents(letters, first, ends)
    point = first + 1
    for _ in range(_MOST_WHOLE):
        further = (letters[point] != ord(".")) & (point < last)
        if not further.any():
            break
        point += further
    pointed = point < last
    before = np.where(pointed, point - first, 0)
    count = last - np.where(pointed, point + 1, first)
    lead, good = _lead(letters, words, first, point, before)
    tail, fine = _tail(words, last, count)
    sure &= good & fine & (before <= 8) & (last >= 24) & (lead * _SIZES[np.minimum(count, 24)] < _LARGEST)
    sure &= (letters[first] != ord("0")) | (np.where(pointed, before, count) == 1)
    mantissa = np.where(sure, lead * _TENS[np.clip(count, 0, 18)] + tail, 0)
    scale, whole = np.where(pointed, count, 0) - exponent, ~pointed & (last == ends)
    sure &= (scale >= 0) & (scale < len(_POWERS)) & ~(whole & minus & (mantissa == 0))  # -0 is 0, -0.0 is not
    return _Decimals(mantissa, scale, minus, whole, sure)


def _exponents(letters: Array, first: Array, ends: Array) -> tuple[Array, Array, Array]:
    """Exponents of two digits, where the numbers end before them, and whether these are exponents."""
    size, last, sure = np.zeros(len(ends), np.int64), ends, np.ones(len(ends), bool)
    rows = np.flatnonzero((letters[ends - 4] == POWER[0]) & (ends - 4 > first))
    if len(rows):
        sign, tens, ones = (letters[ends[rows] - k].astype(np.int64) for k in (3, 2, 1))
        size[rows] = np.where(sign == ord("-"), -1, 1) * ((tens - ord("0")) * 10 + ones - ord("0"))
        digits = (abs(2 * tens - 105) <= 9) & (abs(2 * ones - 105) <= 9)
        sure[rows] = digits & ((sign == ord("-")) | (sign == ord("+")))
        last = ends.copy()
        last[rows] -= 4
    return size, last, sure


def _lead(letters: Array, words: Array, first: Array, point: Array, before: Array) -> tuple[Array, Array]:
    """The `before` (N,) digits before the point, and whether they are digits; mostly there is one."""
    if before.max(initial=0) > 1:
        return _eight(words, point, before)
    digit = (letters[first] - np.uint8(ord("0"))) * before.astype(np.uint8)
    return digit.astype(np.int64), digit <= 9


def _tail(words: Array, last: Array, count: Array) -> tuple[Array, Array]:
    """The `count` (N,) digits that end at bytes `last` (N,), and whether these are 1 to 24 that fit 64 bits."""
    value, sure = _eight(words, last, count)
    sure &= (count > 0) & (count <= 24)
    most = int(count.max(initial=0))
    if most > 8:
        middle, good = _eight(words, last - 8, count - 8)
        value, sure = value + middle * 10**8, sure & good
    if most > 16:
        upper, good = _eight(words, last - 16, count - 16)
        value, sure = value + upper * 10**16, sure & good & (upper < _LARGEST / 1e16)
    return value, sure


def _eight(words: Array, ends: Array, count: Array) -> tuple[Array, Array]:
    """Up to eight digits that end at bytes `ends` (N,) as numbers, and whether they are digits."""
    found = words[np.maximum(ends - 8, 0)]
    if count.min(initial=8) >= 8:
        sure = (found & ~_NIBBLES) == _DIGIT
    else:
        mask = _MASKS[np.clip(count, 0, 8)]
        found &= mask
        sure = (found & ~_NIBBLES) == (_DIGIT & mask)
    found &= _NIBBLES
    for factor, shift, kept in _STEPS:  # digits, pairs and fours of digits are combined within their word
        found = (found * factor >> shift) & kept
    return found.astype(np.int64), sure


def _quotients(read: _Decimals) -> tuple[Array, Array]:
    """Mantissas over powers of ten, and whether rounding is certain to be to the nearest float.

    A quotient's exact remainder corrects it.
    """
    scale = np.clip(read.scale, 0, len(_POWERS) - 1)
    power, high = _POWERS[scale], _HIGH[scale]
    upper = read.mantissa.astype(float)
    lower = (read.mantissa - upper.astype(np.int64)).astype(float)
    quotient = upper / power
    product, wide = quotient * power, _SPLIT * quotient
    left = wide - (wide - quotient)
    right, low = quotient - left, power - high
    error = ((left * high - product) + left * low + right * high) + right * low
    rest = (((upper - product) - error) + lower) / power
    margin = quotient * _MARGIN
    value = quotient + rest
    return np.where(read.minus, -value, value), quotient + (rest - margin) == quotient + (rest + margin)


def _one_by_one(content: bytes | bytearray, starts: Array, ends: Array) -> Array | None:
    """The numbers as `json` reads them, int64 or float64; None if it does not or one exceeds 64 bits."""
    text = b",".join([content[a:b] for a, b in zip(starts.tolist(), ends.tolist(), strict=True)])
    try:
        found = json.loads(b"[" + text.replace(POWER, b"e") + b"]")
        values = np.array(found if len(found) == len(starts) else [None])
    except (ValueError, OverflowError):
        return None
    return values if values.dtype in (np.int64, np.float64) else None
