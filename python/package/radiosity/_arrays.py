"""What users give, as arrays of one form. Everything that is wrong is a ValueError that names the argument."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]

LIMIT = 2**32 - 1
"""Indices have 32 bits."""


def numbers(name: str, values: npt.ArrayLike) -> Doubles:
    """A contiguous array of finite numbers in double precision; copied only where it is none yet."""
    try:
        # ascontiguousarray would make an array of one number out of a number.
        array = np.asarray(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: an array of numbers is wanted ({error})") from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: not all values are finite")
    return array


def points(name: str, values: npt.ArrayLike) -> Doubles:
    """Points or vectors, one a row."""
    array = numbers(name, values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: shape (n, 3) is wanted, not {array.shape}")
    return array


def vector(name: str, values: npt.ArrayLike | None) -> list[float] | None:
    """Three numbers, if any."""
    if values is None:
        return None
    array = numbers(name, values)
    if array.shape != (3,):
        raise ValueError(f"{name}: three numbers are wanted, not shape {array.shape}")
    return array.tolist()  # type: ignore[no-any-return]


def colour(name: str, value: npt.ArrayLike) -> list[float]:
    """A colour R G B, from one number or three."""
    array = numbers(name, value)
    if array.shape not in ((), (3,)):
        raise ValueError(f"{name}: one number or three (R, G, B) are wanted, not shape {array.shape}")
    return np.broadcast_to(array, 3).tolist()  # type: ignore[no-any-return]


def colours(name: str, values: npt.ArrayLike, faces: int) -> Doubles:
    """A colour for each face, from one number, one colour, a number for each face, or a colour for each face.

    Three numbers are a number for each face where there are three faces.
    """
    array = numbers(name, values)
    if array.shape == (faces,):
        array = array[:, np.newaxis]
    elif array.shape not in ((), (3,), (faces, 1), (faces, 3)):
        raise ValueError(
            f"{name}: a number, a colour (3,), or values for {faces} faces, ({faces},) or ({faces}, 3), are wanted, "
            f"not shape {array.shape}"
        )
    return np.ascontiguousarray(np.broadcast_to(array, (faces, 3)))


def polygons(faces: Any, vertices: int) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
    """Corners of all faces one after the other, and the number of corners of each."""
    try:
        array = np.asarray(faces)
    except ValueError:
        array = np.asarray(None)
    if array.ndim == 2 and array.shape[1] >= 3:
        flat = array.reshape(-1)
        sizes = np.full(len(array), array.shape[1], dtype=np.uint32)
    else:
        if not isinstance(faces, Sequence | np.ndarray) or len(faces) == 0:
            raise ValueError("faces: an array (m, 3), or a list of faces with three or more indices each, is wanted")
        try:
            parts = [np.asarray(face).reshape(-1) for face in faces]
        except ValueError as error:
            raise ValueError(f"faces: {error}") from None
        sizes = np.array([len(part) for part in parts], dtype=np.uint32)
        if (sizes < 3).any():
            first = int(np.argmax(sizes < 3))
            raise ValueError(f"faces: face {first} has {sizes[first]} corners, at least 3 are wanted")
        flat = np.concatenate(parts)
    if flat.dtype.kind not in "iu":
        if flat.dtype.kind != "f" or not (flat == np.floor(flat)).all():
            raise ValueError(f"faces: indices of vertices are wanted, not {flat.dtype}")
    if len(flat) == 0:
        raise ValueError("faces: there is no face")
    if flat.min() < 0 or flat.max() >= min(vertices, LIMIT):
        wrong = flat.min() if flat.min() < 0 else flat.max()
        raise ValueError(f"faces: index {wrong} is out of range, there are {vertices} vertices")
    return np.ascontiguousarray(flat, dtype=np.uint32), sizes


def count(name: str, value: int | None, least: int = 1, most: int = LIMIT) -> int | None:
    """A number of things, if any."""
    if value is None:
        return None
    try:
        whole = int(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: a whole number is wanted, not {value!r}") from None
    if whole != value or not least <= whole <= most:
        raise ValueError(f"{name}: a whole number from {least} to {most} is wanted, not {value!r}")
    return whole


def positive(name: str, value: float | None, most: float = np.inf) -> float | None:
    """A number above zero, if any."""
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: a number is wanted, not {value!r}") from None
    if not 0 < number <= most:
        limit = "" if most == np.inf else f" and at most {most:g}"
        raise ValueError(f"{name}: a number above 0{limit} is wanted, not {value!r}")
    return number


def sums(groups: npt.NDArray[np.int64], values: Doubles, count: int) -> Doubles:
    """Sums of the values of each group."""
    return np.bincount(groups, weights=values, minlength=count).astype(np.float64, copy=False)


def seed_of(seed: int) -> int:
    """A seed of 64 bits."""
    whole = count("seed", seed, 0, 2**64 - 1)
    assert whole is not None
    return whole


def threads_of(threads: int | None) -> int | None:
    """A number of threads; more than there are processors gain nothing."""
    return count("threads", threads, 1, 1024)
