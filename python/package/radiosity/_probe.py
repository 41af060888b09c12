"""Irradiance at points."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from . import _arrays
from ._arrays import Doubles
from ._progress import Progress, shown
from ._radiosity import probe as _probe
from ._scene import Scene
from ._solve import Solution


class Probes(NamedTuple):
    """Irradiance at points."""

    irradiance: Doubles
    """(n, 3) irradiance R, G, B, W/m2."""
    standard_error: Doubles
    """(n, 3) its standard error, W/m2."""


def probe(
    source: Scene | Solution,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    *,
    samples: int | None = None,
    next_event: bool = True,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
) -> Probes:
    """Irradiance (W/m2) at points, each facing along a normal, with its standard error.

    Parameters
    ----------
    source : a `Scene`, from whose lamps paths are traced; or a `Solution`, of which the last bounce is gathered. The standard
        error of a solution covers that bounce only.
    points : (n, 3) positions, in the unit of the scene.
    normals : (n, 3), or (3,) for all points.
    samples : paths for each point, 4096 by default; powers of two suit the sequences best.
    next_event : whether paths are connected to lamps at each bounce.
    seed, threads, progress : as in `solve`.

    >>> lamp = Scene([[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]], [[0, 1, 2, 3]], emission=1)
    >>> E, standard_error = probe(lamp, [[0.5, 0, 0.5]], [0, 1, 0])
    >>> E.round(2)  # pi times the view factor 0.2395
    array([[0.75, 0.75, 0.75]])
    """
    places = _arrays.points("points", points)
    directions = _arrays.numbers("normals", normals)
    if directions.shape not in ((3,), places.shape):
        raise ValueError(f"normals: shape (3,) or {places.shape} is wanted, not {directions.shape}")
    directions = np.ascontiguousarray(np.broadcast_to(directions, places.shape))
    length = np.linalg.norm(directions, axis=1)
    if not (length > 0).all():
        raise ValueError("normals: a normal is zero")
    if not isinstance(source, Scene | Solution):
        raise ValueError(f"source: a Scene or a Solution is wanted, not {type(source).__name__}")
    with shown(progress) as callback:
        mean, error, buried = _probe(
            source._core,
            places,
            directions,
            _arrays.count("samples", samples, 1, 2**30),
            next_event,
            _arrays.seed_of(seed),
            _arrays.threads_of(threads),
            callback,
        )
    if buried:
        warnings.warn(
            f"{len(buried)} points lie below a surface or inside a solid, and see little but backs: the first is {buried[0]}",
            stacklevel=2,
        )
    return Probes(mean.reshape(-1, 3), error.reshape(-1, 3))
