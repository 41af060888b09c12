"""Lightmaps."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from . import _arrays
from ._arrays import Doubles
from ._progress import Progress, shown
from ._radiosity import Lightmap as _Lightmap
from ._radiosity import bake as _bake
from ._scene import Scene
from ._solve import Solution, form_factors


class Lightmap:
    """Irradiance of the surfaces as images, and texture coordinates that address them.

    The first row of an image is its lowest, at v = 0. Facets are triangles of the scene, or parts of them where charts would be
    too large.
    """

    def __init__(self, core: _Lightmap, solution: Solution) -> None:
        self._core = core
        self.solution = solution
        """The solution that was baked."""

    def __repr__(self) -> str:
        pages, height, width = self._core.shape
        return f"<radiosity.Lightmap of {self.solution.scene._core.name}: {pages} pages of {width} x {height} texels>"

    @cached_property
    def irradiance(self) -> npt.NDArray[np.float32]:
        """(pages, height, width, 3) irradiance R, G, B, W/m2."""
        return self._core.irradiance.reshape(*self._core.shape, 3)

    @cached_property
    def standard_error(self) -> npt.NDArray[np.float32] | None:
        """The same shape: standard error of the final gather, W/m2. NaN where there is none, None without a final gather."""
        errors = self._core.standard_error
        return None if errors is None else errors.reshape(*self._core.shape, 3)

    @cached_property
    def kind(self) -> npt.NDArray[np.uint8]:
        """(pages, height, width) what texels hold: 0 nothing, 1 surface, 2 hidden surface, 3 values of neighbours."""
        return self._core.kind.reshape(self._core.shape)

    @cached_property
    def corners(self) -> Doubles:
        """(f, 3, 3) positions of the corners of each facet."""
        return self._core.corners.reshape(-1, 3, 3)

    @cached_property
    def uv(self) -> Doubles:
        """(f, 3, 2) texture coordinates of these corners, 0 to 1; NaN for a facet without a place in the map."""
        return self._core.uv.reshape(-1, 3, 2)

    @cached_property
    def page(self) -> npt.NDArray[np.uint32]:
        """(f,) the page of each facet."""
        return self._core.page

    @cached_property
    def parent(self) -> npt.NDArray[np.int64]:
        """(f,) the face of the scene that each facet is of."""
        return np.asarray(self.solution.scene.face_of_triangles[self._core.triangle.view(np.int64)])

    @property
    def flux(self) -> dict[str, npt.NDArray[np.float64]]:
        """Power that arrives, W, R, G, B: of the "solver", of the "map", and the "standard_error" of that."""
        return dict(zip(("solver", "map", "standard_error"), np.array(self._core.flux), strict=True))

    @property
    def relative_error(self) -> float:
        """RMS standard error of the final gather relative to the mean irradiance; 0 without one."""
        return self._core.relative_error

    @property
    def new_uv(self) -> str | None:
        """Why new texture coordinates were made; None where those of the file were used."""
        return self._core.refused


def bake(
    source: Scene | Solution,
    *,
    resolution: int | None = None,
    texel: float | None = None,
    uv: str = "auto",
    two_sided: bool = False,
    final_gather: int | None = None,
    denoise: bool = True,
    dilate: bool = True,
    close_seams: bool = True,
    quality: str | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
) -> Lightmap:
    """Bake a lightmap: the irradiance (W/m2) of all surfaces as images, with texture coordinates.

    Parameters
    ----------
    source : a `Solution`, or a `Scene`, which is solved first with this `quality` and `seed`.
    resolution : texels a side of a page, 512 by default.
    texel : length of a texel, in the unit of the scene; the map takes as many pages as it needs.
    uv : texture coordinates: those of the file if they suit ("auto"), or else an error ("keep"), or "new" ones.
    two_sided : whether both sides of a face get texels where light reaches both.
    final_gather : rays for each texel; 0 takes the irradiance of the patches.
    denoise, dilate, close_seams : whether noise is removed, empty texels are filled from neighbours, and seams are smoothed.
    seed, threads, progress : as in `solve`.

    >>> lamp, floor = [[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]], [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]
    >>> scene = Scene(lamp + floor, [[0, 1, 2, 3], [4, 5, 6, 7]], emission=[1, 0])
    >>> lightmap = bake(scene, resolution=32, quality="draft", final_gather=16)
    >>> lightmap.irradiance.shape, lightmap.uv.shape
    ((1, 32, 32, 3), (4, 3, 2))
    """
    with shown(progress) as callback:
        if isinstance(source, Solution):
            if quality is not None:
                raise ValueError("quality: a Solution has one already")
            solution = source
        elif isinstance(source, Scene):
            # Texels need the light, and not the errors of patches that `solve` estimates.
            factors = form_factors(source, quality=quality, seed=seed, threads=threads, progress=callback)
            solution = factors.solve(threads=threads, progress=callback)
        else:
            raise ValueError(f"source: a Scene or a Solution is wanted, not {type(source).__name__}")
        baking = {
            "resolution": _arrays.count("resolution", resolution, 1, 16384),
            "texel": _arrays.positive("texel", texel, 1e300),
            "coordinates": uv,
            "two_sided": two_sided,
            "final_gather": _arrays.count("final_gather", final_gather, 0, 65536),
            "denoise": denoise,
            "dilate": dilate,
            "close_seams": close_seams,
            "seed": _arrays.seed_of(seed),
        }
        core = _bake(solution._core, baking, _arrays.threads_of(threads), callback)
    return Lightmap(core, solution)
