"""Pictures."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt

from . import _arrays
from ._progress import Progress, shown
from ._radiosity import render as _render
from ._radiosity import to_srgb as _to_srgb
from ._scene import Scene
from ._solve import Solution


def render(
    source: Scene | Solution,
    *,
    width: int = 640,
    height: int = 480,
    eye: npt.ArrayLike | None = None,
    look_at: npt.ArrayLike | None = None,
    up: npt.ArrayLike | None = None,
    fov: float | None = None,
    method: str = "path",
    samples: int = 64,
    next_event: bool = True,
    final_gather: int | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
) -> npt.NDArray[np.float32]:
    """A picture as an array (height, width, 3) of radiance R, G, B, W/(m2 sr). The first row is the top.

    Parameters
    ----------
    source : a `Scene`, which is rendered by path or light tracing; or a `Solution`, whose light is shown.
    width, height : pixels.
    eye, look_at, up : (3,) position of the camera, the point in the middle of the picture, and the direction that is upwards.
        Those that are not given are chosen so that the scene fills the picture.
    fov : vertical angle of view in degrees.
    method : "path" or "light" tracing of a scene.
    samples : samples for each pixel.
    next_event : whether paths are connected to lamps at each bounce.
    final_gather : of a solution: rays for each sample that gather the last bounce, instead of interpolating between patches.
    seed, threads, progress : as in `solve`.

    >>> lamp = Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], emission=[3, 2, 1])
    >>> picture = render(lamp, width=8, height=4, samples=4)
    >>> picture.shape, picture.max(axis=(0, 1)).tolist()
    ((4, 8, 3), [3.0, 2.0, 1.0])
    """
    if not isinstance(source, Scene | Solution):
        raise ValueError(f"source: a Scene or a Solution is wanted, not {type(source).__name__}")
    if method not in ("path", "light"):
        raise ValueError(f'method: "path" or "light" is wanted, not {method!r}; a Solution is rendered by itself')
    if method == "light" and not next_event:
        raise ValueError("next_event: light tracing needs it")
    if final_gather is not None and isinstance(source, Scene):
        raise ValueError("final_gather: it gathers from a Solution, not from a Scene")
    view = {
        "width": _arrays.count("width", width, 1, 1 << 20),
        "height": _arrays.count("height", height, 1, 1 << 20),
        "eye": _arrays.vector("eye", eye),
        "look_at": _arrays.vector("look_at", look_at),
        "up": _arrays.vector("up", up),
        "fov": _arrays.positive("fov", fov, 180.0),
    }
    rendering = {
        "method": method,
        "samples": _arrays.count("samples", samples, 1, 1 << 30),
        "next_event": next_event,
        "final_gather": _arrays.count("final_gather", final_gather, 1, 65536),
        "seed": _arrays.seed_of(seed),
    }
    with shown(progress) as callback:
        flat, warning = _render(source._core, view, rendering, _arrays.threads_of(threads), callback)
    if warning is not None:
        warnings.warn(warning, stacklevel=2)
    return flat.reshape(height, width, 3)


def to_srgb(
    picture: npt.ArrayLike, *, white: float | None = None, stops: float = 0.0
) -> npt.NDArray[np.uint8]:
    """A picture of linear radiance (..., 3) as eight-bit sRGB of the same shape, to look at or to save as a PNG.

    Parameters
    ----------
    picture : (..., 3) linear values.
    white : the value that is shown as white; chosen so that nine tenths of the lit pixels are below it by default.
    stops : makes the picture brighter by this number of stops.

    >>> to_srgb([[0.0, 0.5, 1.0]], white=1.0).tolist()
    [[0, 188, 255]]
    """
    array = _arrays.numbers("picture", picture)
    if array.ndim < 1 or array.shape[-1] != 3:
        raise ValueError(f"picture: a shape (..., 3) is wanted, not {array.shape}")
    white = _arrays.positive("white", white)
    if not -100 <= stops <= 100:
        raise ValueError(f"stops: a number from -100 to 100 is wanted, not {stops!r}")
    return _to_srgb(array, white, float(stops)).reshape(array.shape)
