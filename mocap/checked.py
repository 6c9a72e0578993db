"""What callers give, checked where it comes in: each error names the field, what was found and expected."""

from __future__ import annotations

import math
import numbers
from collections.abc import Collection, Iterable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.errors import PoserError, ShapeError

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


def number(
    value: Any, what: str, *, above: float = -math.inf, least: float = -math.inf,
    infinite: bool = False, error: type[PoserError] = ShapeError,
) -> float:  # fmt: skip
    """`value`, a real number greater than `above` and no less than `least`; infinity only where it may be.

    Raises `error` for another type (a truth value, text, a complex number), NaN, and what lies outside.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise error(f"{what} must be a number, got {value!r}")
    try:
        found = float(value)
    except OverflowError as e:  # a whole number of more than 308 digits
        raise error(f"{what} must be a number of ordinary size") from e
    wanted = f" above {above:g}" if above > -math.inf else ""
    wanted = wanted or (f" of {least:g} or more" if least > -math.inf else "")
    finite = math.isfinite(found) or (infinite and found > 0)
    if not finite or not found > above or not found >= least:
        raise error(
            f"{what} must be a {'' if infinite else 'finite '}number{wanted}, got {value!r}"
        )
    return found


def array(value: Any, what: str) -> Array:
    """A copy as floats, NaN where something is missing. Raises ShapeError for None, text, complex numbers and
    lists of unequal lengths."""
    given = _given(value, f"{what} must be an array of numbers")
    if given.dtype.kind not in "fiu":
        raise ShapeError(f"{what} must be an array of real numbers, got {_words(value, given)}")
    return np.array(given, float)


def truths(
    value: Any, shape: tuple[int, ...], what: str, error: type[PoserError] = ShapeError
) -> Bools:
    """A copy of this shape as truth values; whole numbers count as such. Raises `error`."""
    wanted = f"{what} must be {shape} bool"
    given = _given(value, wanted, error)
    if given.shape != shape or given.dtype.kind not in "bui":
        raise error(f"{wanted}, got {given.shape} {given.dtype}")
    return np.array(given, bool)


def whole(value: Any, what: str, error: type[PoserError] = ShapeError) -> NDArray[np.int64]:
    """A copy as whole numbers. Raises `error`."""
    given = _given(value, f"{what} must be whole numbers", error)
    if given.dtype.kind not in "ui":
        raise error(f"{what} must be whole numbers, got {_words(value, given)}")
    return np.array(given, np.int64)


def names(value: Any, what: str, error: type[PoserError] = ShapeError) -> tuple[str, ...]:
    """Texts in order. Raises `error`, also for a single text, which would pass for its letters."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise error(f"{what} must be several names, as in ('head', 'pelvis'), got {value!r}")
    return tuple(str(n) for n in value)


def _given(value: Any, wanted: str, error: type[PoserError] = ShapeError) -> NDArray[Any]:
    # RuntimeError: a tensor that needs gradients. Those of torch's device meta hold no numbers: TypeError.
    try:
        return np.asarray(value)
    except (ValueError, TypeError, RuntimeError) as e:
        raise error(f"{wanted} ({e})") from e


def instance(value: Any, kind: type, what: str, error: type[PoserError] = ShapeError) -> None:
    """Raises `error` where `value` is of another class."""
    if not isinstance(value, kind):
        raise error(f"{what} must be a {kind.__name__}, got {type(value).__name__}")


def settings(
    given: Any, *, positive: Collection[str] = (), free: Collection[str] = (),
    infinite: Collection[str] = (), error: type[PoserError] = ShapeError,
) -> None:  # fmt: skip
    """Check the fields of a dataclass whose defaults are numbers or truth values: sizes, zero or more.

    positive: those above zero. free: of any sign, or checked elsewhere. infinite: those that may be infinity.
    A number of frames or steps (its default is whole) must be whole, too. Raises `error`.
    """
    name = type(given).__name__
    for field in fields(given):
        value, what = getattr(given, field.name), f"{name}: {field.name}"
        if field.name in free:
            continue
        if isinstance(field.default, bool):
            if not isinstance(value, bool | np.bool_):
                raise error(f"{what} must be True or False, got {value!r}")
        elif isinstance(field.default, int | float):
            above = 0.0 if field.name in positive else -math.inf
            number(
                value, what, above=above, least=0.0, infinite=field.name in infinite, error=error
            )
            if isinstance(field.default, int) and not isinstance(value, numbers.Integral):
                raise error(f"{what} must be a whole number, got {value!r}")


def _words(value: Any, given: NDArray[Any]) -> str:
    return "None" if value is None else f"an array of {given.dtype}"
