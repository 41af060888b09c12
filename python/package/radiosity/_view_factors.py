"""View factors between surfaces."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _arrays
from ._arrays import Doubles
from ._progress import Progress, shown
from ._radiosity import ViewFactors as _ViewFactors
from ._radiosity import view_factors as _view_factors
from ._scene import Scene, _joined, _pyvista_surfaces, _split, _trimesh_parts

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


class Share(NamedTuple):
    """A share of what leaves each surface."""

    value: Doubles
    """(n,) shares."""
    standard_error: Doubles
    """(n,) their standard errors."""


class ViewFactors:
    """F[i, j] leaves surface i and arrives at surface j: the share of what leaves i that arrives at j.

    `F, standard_error = view_factors(...)` unpacks the two matrices, and `numpy.asarray(...)` gives the first.
    """

    def __init__(self, core: _ViewFactors, kept: npt.NDArray[np.int64], n: int) -> None:
        self._core = core
        # Where each surface of the computation is among those that were given: faces without area are left out.
        self._kept = kept
        self._n = n

    def __len__(self) -> int:
        """Number of surfaces."""
        return self._n

    def __repr__(self) -> str:
        return f"<radiosity.ViewFactors: {self._n} surfaces, error {self.error:.1e}>"

    def __iter__(self) -> Iterator[Doubles]:
        return iter((self.F, self.standard_error))

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return self.F.astype(self.F.dtype if dtype is None else dtype, copy=bool(copy))

    def __getitem__(self, at: Any) -> Any:
        return self.F[at]

    @cached_property
    def _dense(self) -> tuple[Doubles, Doubles]:
        k, n = len(self._kept), self._n
        matrices = []
        for flat in self._core.dense():
            matrix = flat.reshape(k, k)
            if k < n:
                whole = np.zeros((n, n))
                whole[np.ix_(self._kept, self._kept)] = matrix
                matrix = whole
            matrices.append(matrix)
        return matrices[0], matrices[1]

    @property
    def F(self) -> Doubles:
        """(n, n) view factors: F[i, j] leaves i and arrives at j. Rows sum to 1 with `escaped`."""
        return self._dense[0]

    @property
    def standard_error(self) -> Doubles:
        """(n, n) their standard errors; 1e-5 of the view factor where nothing is in between."""
        return self._dense[1]

    def matrix(self) -> csr_matrix:
        """The view factors as a `scipy.sparse.csr_matrix`, for many surfaces of which few see each other."""
        from scipy.sparse import csr_matrix

        values, _, columns, starts = self._core.rows()
        k, n = len(self._kept), self._n
        matrix = csr_matrix((values, columns.view(np.int32), starts), shape=(k, k), copy=False)
        if k < n:
            place = csr_matrix((np.ones(k), (self._kept, np.arange(k))), shape=(n, k))
            matrix = place @ matrix @ place.T
        matrix.eliminate_zeros()
        return matrix

    def _whole(self, values: Doubles) -> Doubles:
        whole = np.zeros(self._n)
        whole[self._kept] = values
        return whole

    def _lost(self, what: str) -> Share:
        value, error = self._core.lost(what)
        return Share(self._whole(value), self._whole(error))

    @cached_property
    def area(self) -> Doubles:
        """(n,) areas of the surfaces that can be seen; 0 for a surface that was left out."""
        return self._whole(self._core.area)

    @property
    def names(self) -> list[str]:
        """Names of the surfaces: numbers of faces, or names of groups, objects or materials."""
        if self._n == len(self._kept):
            return self._core.names
        return [str(i) for i in range(self._n)]

    @property
    def escaped(self) -> Doubles:
        """(n,) share of what leaves each surface that arrives at no surface: it leaves the scene, or meets a back or obstacle."""
        return self._lost("escaped").value

    @property
    def backs(self) -> Share:
        """Of `escaped`, what meets backs of surfaces, and obstacles."""
        return self._lost("backs")

    @property
    def sky(self) -> Share:
        """Of `escaped`, what leaves the scene upward: sky view factors."""
        return self._lost("up")

    @property
    def ground(self) -> Share:
        """Of `escaped`, what leaves the scene downward."""
        return self._lost("down")

    @property
    def error(self) -> float:
        """RMS standard error of all view factors that are not zero."""
        return self._core.error

    @property
    def rays(self) -> int:
        """Rays cast, for pairs between which something stands."""
        return self._core.rays

    @property
    def enclosed(self) -> bool:
        """Whether the surfaces enclose a room, so that rows sum to 1."""
        return self._core.enclosed


def view_factors(
    surfaces: Any,
    faces: Any = None,
    *,
    obstacles: Any = None,
    error: float = 1e-4,
    by: str = "face",
    side: str = "front",
    enclosed: bool | None = None,
    up: npt.ArrayLike = (0.0, 1.0, 0.0),
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
) -> ViewFactors:
    """View factors between surfaces: F[i, j] leaves i and arrives at j.

    Parameters
    ----------
    surfaces : a `Scene`; or vertices (n, 3), with `faces`; or a list of polygons, each an array (k, 3) of its corners; or a mesh of
        trimesh or pyvista. A surface is seen from its front, where its corners run counter-clockwise. Both sides block.
    faces : (m, 3), (m, k) or a list of faces of any number of corners, as indices of vertices.
    obstacles : more faces that only block, from both sides: a pair (vertices, faces), a list of polygons, or a mesh; of a `Scene`,
        a list of names of materials.
    error : sample until the RMS standard error of all view factors that are not zero is below this, 1e-7 to 0.1. What two
        surfaces exchange with nothing in between has a relative error of 1e-5 at most.
    by : of a scene: what one surface is, a "face", or all faces of a "group", an "object", a "material", or of one value of a
        property of a .ply, "property:NAME".
    side : the sides that are surfaces: "front", "back", or "both": all fronts, then all backs.
    enclosed : whether the surfaces enclose a room. Rays find out if it is None.
    up : the direction of the sky, for `sky` and `ground`.
    seed, threads, progress : as in `solve`.

    Other programs may return the transpose: F[j, i] of pyviewfactor is F[i, j] here.

    Two squares that face each other at the distance of their sides (Howell, C-11: 0.19982):

    >>> floor = [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]
    >>> roof = [[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]]
    >>> F, standard_error = view_factors([floor, roof])
    >>> F.round(5)
    array([[0.     , 0.19982],
           [0.19982, 0.     ]])
    """
    if not 1e-7 <= error <= 0.1:
        raise ValueError(f"error: a number from 1e-7 to 0.1 is wanted, not {error!r}")
    scene, n, blocking = _scene_of(surfaces, faces, obstacles)
    direction = _arrays.vector("up", up)
    assert direction is not None
    if not any(direction):
        raise ValueError("up: a direction is wanted, not zero")
    with shown(progress) as callback:
        core = _view_factors(
            scene._core,
            by,
            side,
            blocking,
            float(error),
            enclosed,
            direction,
            _arrays.seed_of(seed),
            _arrays.threads_of(threads),
            callback,
        )
    for warning in core.warnings:
        warnings.warn(warning, stacklevel=2)
    names = core.names
    if by == "face":
        # Fronts, then backs; faces without area are among neither.
        place = [int(name.removesuffix(" back")) + (n if name.endswith(" back") else 0) for name in names]
        kept = np.array(place, dtype=np.int64)
        n = 2 * n if side == "both" else n
    else:
        n, kept = len(names), np.arange(len(names))
    return ViewFactors(core, kept, n)


def _parts(argument: str, surfaces: Any, faces: Any) -> tuple[Any, list[Any]]:
    """Vertices, and the corners of each face."""
    if faces is not None:
        places = _arrays.points(argument, surfaces)
        flat, sizes = _arrays.polygons(faces, len(places))
        return places, list(np.split(flat, np.cumsum(sizes)[:-1]))
    if hasattr(surfaces, "n_cells") or hasattr(surfaces, "n_blocks"):
        meshes = [(name, mesh.points, _split(np.asarray(mesh.faces))) for name, mesh in _pyvista_surfaces(surfaces)]
        return _joined(meshes)[:2]
    if hasattr(surfaces, "faces") or hasattr(surfaces, "geometry"):
        return _joined(_trimesh_parts(surfaces))[:2]
    try:
        polygons = [_arrays.points(f"{argument}[{k}]", polygon) for k, polygon in enumerate(surfaces)]
    except TypeError:
        raise ValueError(f"{argument}: a scene, vertices with faces, or a list of polygons is wanted") from None
    if not polygons:
        raise ValueError(f"{argument}: there is no polygon")
    ends = np.cumsum([len(polygon) for polygon in polygons])
    corners = [np.arange(end - len(polygon), end) for polygon, end in zip(polygons, ends, strict=True)]
    return np.concatenate(polygons), corners


_SURFACE, _OBSTACLE = "surface", "obstacle"


def _scene_of(surfaces: Any, faces: Any, obstacles: Any) -> tuple[Scene, int, list[str]]:
    """A scene of surfaces and obstacles, how many faces can be surfaces, and the materials that only block."""
    if isinstance(surfaces, Scene):
        if faces is not None:
            raise ValueError("faces: a scene has its own; surfaces are vertices where faces are given")
        names = [] if obstacles is None else obstacles
        if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
            raise ValueError("obstacles: names of materials of the scene are wanted")
        return surfaces, len(surfaces), list(names)
    places, corners = _parts("surfaces", surfaces, faces)
    n = len(corners)
    materials = [_SURFACE] * n
    if obstacles is not None:
        pair = isinstance(obstacles, tuple) and len(obstacles) == 2
        more, theirs = _parts("obstacles", *(obstacles if pair else (obstacles, None)))
        corners = corners + [face + len(places) for face in theirs]
        places = np.concatenate([places, more])
        materials += [_OBSTACLE] * len(theirs)
    with warnings.catch_warnings():
        # Faces without area have a row of zeros.
        warnings.filterwarnings("ignore", "left out")
        scene = Scene(places, corners, materials=materials)
    return scene, n, [] if obstacles is None else [_OBSTACLE]
