"""Solutions, and form factors to solve with again and again."""

from __future__ import annotations

import json
import math
import os
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from . import _arrays
from ._arrays import Doubles
from ._progress import Progress, shown
from ._radiosity import FormFactors as _FormFactors
from ._radiosity import Solution as _Solution
from ._radiosity import form_factors as _form_factors
from ._radiosity import solve as _solve
from ._scene import Scene, Values

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


def casting(
    *,
    error: float | None = None,
    rays: int | None = None,
    patches: int | None = None,
    patch_size: float | None = None,
    quality: str | None = None,
    estimator: str = "pooled",
    solver: str = "auto",
    tolerance: float | None = None,
    linear: bool = True,
    seed: int = 0,
) -> dict[str, Any]:
    """The numbers of patches and rays, checked."""
    if error is not None and rays is not None:
        raise ValueError("error: it decides the number of rays, so rays cannot be given too")
    if patch_size is not None and patches is not None:
        raise ValueError("patches: give either patches or patch_size")
    if tolerance is not None and not 0 < tolerance < 1:
        raise ValueError(f"tolerance: a number between 0 and 1 is wanted, not {tolerance!r}")
    return {
        "error": _arrays.positive("error", error, 1.0),
        "rays": _arrays.count("rays", rays),
        "patches": _arrays.count("patches", patches, 1, 2**31 - 1),
        "patch_size": _arrays.positive("patch_size", patch_size),
        "quality": quality,
        "estimator": estimator,
        "solver": solver,
        "tolerance": None if tolerance is None else float(tolerance),
        "linear": bool(linear),
        "seed": _arrays.seed_of(seed),
    }


@dataclass(frozen=True)
class Patches:
    """Pieces of the faces, over each of which light is linear. Those of fronts come first, then those of backs that rays
    have met."""

    vertices: Doubles
    """(v, 3) positions."""
    faces: npt.NDArray[np.uint32]
    """(p, 3) vertices of each patch, counter-clockwise as seen from its side."""
    parent: npt.NDArray[np.int64]
    """(p,) the face of the scene that each patch is of."""
    front: npt.NDArray[np.bool_]
    """(p,) whether the patch is on the front of its face."""
    area: Doubles
    """(p,) areas."""
    reflectance: Doubles
    """(p, 3) reflectance R, G, B."""
    emission: Doubles
    """(p, 3) emitted radiosity, W/m2: pi times the radiance."""

    def __len__(self) -> int:
        return len(self.faces)

    @cached_property
    def centroid(self) -> Doubles:
        """(p, 3) centroids."""
        return np.asarray(self.vertices[self.faces].mean(axis=1))

    @cached_property
    def normal(self) -> Doubles:
        """(p, 3) unit normals, on the side of the patch."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))


class Solution:
    """The light on all patches of a scene.

    Arrays have a row for each patch and columns R, G, B; those of a grey scene are equal. They are made when they are first asked
    for, and kept.
    """

    def __init__(self, core: _Solution) -> None:
        self._core = core
        for warning in core.warnings:
            warnings.warn(warning, stacklevel=3)

    def __len__(self) -> int:
        """Number of patches."""
        return len(self.patches)

    def __repr__(self) -> str:
        error = self.errors["sampling"]
        shown = "" if error is None else f", sampling error {100 * error:.2g} %"
        return f"<radiosity.Solution of {self._core.scene.name}: {len(self)} patches, {self.rays:.0f} rays each{shown}>"

    @property
    def scene(self) -> Scene:
        """The scene that was solved."""
        return Scene._of(self._core.scene)

    @cached_property
    def irradiance(self) -> Doubles:
        """(p, 3) irradiance, W/m2: power that arrives, per area."""
        return self._core.irradiance.reshape(-1, 3)

    @cached_property
    def radiosity(self) -> Doubles:
        """(p, 3) radiosity, W/m2: power that leaves, emitted and reflected, per area. Radiance is radiosity / pi."""
        return self._core.radiosity.reshape(-1, 3)

    @cached_property
    def standard_error(self) -> Doubles:
        """(p, 3) standard error of the irradiance from sampling, W/m2. 95 % intervals are 2.13 of it to either side."""
        return self._core.standard_error.reshape(-1, 3)

    @cached_property
    def slopes(self) -> Doubles | None:
        """(p, 3, 2) how irradiance varies over each patch, W/m2, R, G, B; None where light is constant on each patch.

        At barycentric coordinates b of a patch the irradiance is `irradiance + slopes[..., 0] * (b[0] - b[1]) + slopes[..., 1] *
        (b[0] + b[1] - 2 * b[2])`.
        """
        values = self._core.slopes
        return None if values is None else values.reshape(-1, 3, 2)

    @cached_property
    def discretisation_error(self) -> Doubles | None:
        """(p, 3) estimated error of the irradiance from the size of the patches, W/m2; None where it is unknown."""
        values = self._core.discretisation
        return None if values is None else values.reshape(-1, 3)

    @cached_property
    def patches(self) -> Patches:
        """The patches: vertices, faces, parent, front, area, reflectance, emission."""
        vertices, faces = self._core.mesh()
        triangle = self._core.triangle.view(np.int64)
        return Patches(
            vertices=vertices.reshape(-1, 3),
            faces=faces.reshape(-1, 3),
            parent=self.scene.face_of_triangles[triangle],
            front=np.arange(len(triangle)) < self._core.fronts,
            area=self._core.area,
            reflectance=self._core.reflectance.reshape(-1, 3),
            emission=self._core.emission.reshape(-1, 3),
        )

    @cached_property
    def ledger(self) -> dict[str, Any]:
        """The energy ledger: power "emitted" by faces, "entered" from sun, sky and other lights, "absorbed" and "escaped", W, each R,
        G, B; the "imbalance" is relative to what is emitted and enters."""
        return dict(json.loads(self._core.ledger))

    @property
    def errors(self) -> dict[str, float | None]:
        """Estimated RMS errors relative to the mean irradiance: "sampling", "discretisation" (of constant light), both together
        as "total", "bias" and "solver".

        None where an error is unknown. `FormFactors.solve` does not estimate discretisation and bias.
        """
        names = ("sampling", "discretisation", "bias", "solver")
        errors = dict(zip(names, self._core.errors, strict=True))
        sampling, discretisation = errors["sampling"], errors["discretisation"]
        errors["total"] = None
        if sampling is not None and discretisation is not None:
            errors["total"] = math.hypot(sampling, discretisation)
        return errors

    @property
    def standard_error_of_mean(self) -> Doubles:
        """(3,) standard error of the mean irradiance of all patches, W/m2: smaller than that of independent patches."""
        return self._core.of_mean

    @property
    def rays(self) -> float:
        """Mean number of rays a patch."""
        return self._core.rays

    @property
    def rounds(self) -> list[dict[str, float]]:
        """What each round of sampling reached: "rays" a patch, relative "error", and "seconds" since the first round began."""
        return [{"rays": rays, "error": error, "seconds": at} for rays, error, at in self._core.rounds]

    @property
    def solver(self) -> dict[str, Any]:
        """The "name" of the solver, its "iterations", and the relative "residual"."""
        name, iterations, residual = self._core.solver
        return {"name": name, "iterations": iterations, "residual": residual}

    def by_face(self, values: str | npt.ArrayLike = "irradiance", side: str = "front") -> Doubles:
        """(m, 3) means over the faces of the scene, weighted by area; NaN where a face has no patch on that side.

        Parameters
        ----------
        values : "irradiance", "radiosity", or an array with a row for each patch.
        side : "front" or "back".
        """
        if isinstance(values, str):
            if values not in ("irradiance", "radiosity"):
                raise ValueError(f'values: "irradiance", "radiosity" or an array is wanted, not {values!r}')
            array = self.irradiance if values == "irradiance" else self.radiosity
        else:
            array = _arrays.numbers("values", values)
            if array.ndim not in (1, 2) or len(array) != len(self):
                raise ValueError(f"values: a row for each of the {len(self)} patches is wanted, not shape {array.shape}")
        if side not in ("front", "back"):
            raise ValueError(f'side: "front" or "back" is wanted, not {side!r}')
        patches = self.patches
        chosen = patches.front if side == "front" else ~patches.front
        parent, weight, m = patches.parent[chosen], patches.area[chosen], len(self.scene)
        columns = array[chosen].reshape(len(parent), -1).T
        area = np.bincount(parent, weights=weight, minlength=m)
        sums = [np.bincount(parent, weights=weight * column, minlength=m) for column in columns]
        with np.errstate(invalid="ignore"):
            return np.asarray((np.array(sums) / area).T)

    def save(self, path: str | os.PathLike[str], *, backs: bool = False) -> None:
        """Write a coloured mesh, .ply (all figures) or .glb, as the command `radiosity solve -o` does.

        `backs` writes both sides of each patch to a .ply, not only the one with more light.
        """
        name = os.fspath(path)
        if not name.lower().endswith((".ply", ".glb")):
            raise ValueError(f"path: a name that ends in .ply or .glb is wanted, not {name!r}")
        self._core.save(name, backs)


def solve(
    scene: Scene,
    *,
    error: float | None = None,
    rays: int | None = None,
    patches: int | None = None,
    patch_size: float | None = None,
    quality: str | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
    linear: bool = True,
    solver: str = "auto",
    tolerance: float | None = None,
    estimator: str = "pooled",
) -> Solution:
    """Compute irradiance (W/m2), radiosity (W/m2) and standard errors on all patches of a scene.

    Parameters
    ----------
    scene : a scene with light: faces that emit, sun, sky or luminaires.
    error : sample until the estimated RMS error is at most this share of the mean irradiance, for example 0.01. Patches are made
        small enough too, unless `patches` or `patch_size` is given.
    rays : mean number of rays a patch.
    patches : approximate number of patches; there is at least one per triangle.
    patch_size : largest edge of a patch, in the unit of the scene. `inf` makes each triangle one patch of constant light.
    quality : preset of the numbers of patches and rays: "draft", "medium" (the default), "high" or "reference".
    seed : the same seed gives the same bytes.
    threads : number of threads; all processors by default. The result does not depend on it.
    progress : True for a bar on a terminal, `tqdm`, or a function of (stage, done, total). What it raises ends the computation.
    linear : whether light varies linearly over each patch. Otherwise it is constant, and the discretisation error is two to five
        times as large.
    solver : "auto", "cg", "gauss-seidel", "jacobi", "southwell" or "direct".
    tolerance : relative residual to reach, 1e-10 by default.
    estimator : "pooled" or "one-way" form factors.

    Raises ValueError for arguments and scenes that cannot be used, MemoryError before the work if it would not fit.

    >>> box = Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
    ...             reflectance=0.5, emission=[1, 0, 0, 0])
    >>> solution = solve(box, patches=100, rays=64)
    >>> solution.irradiance.shape == (len(solution), 3)
    True
    >>> abs(solution.ledger["imbalance"]) < 1e-9
    True
    """
    options = casting(
        error=error,
        rays=rays,
        patches=patches,
        patch_size=patch_size,
        quality=quality,
        estimator=estimator,
        solver=solver,
        tolerance=tolerance,
        linear=linear,
        seed=seed,
    )
    with shown(progress) as callback:
        return Solution(_solve(_core_of(scene), options, _arrays.threads_of(threads), callback))


class FormFactors:
    """F[i, j] is the share of the light leaving patch i that arrives at patch j. Made by `form_factors`."""

    def __init__(self, scene: Scene, core: _FormFactors) -> None:
        self.scene = scene
        self._core = core

    def __len__(self) -> int:
        """Number of patches."""
        return self._core.patches

    def __repr__(self) -> str:
        return f"<radiosity.FormFactors of {self.scene._core.name}: {len(self)} patches, {self._core.rays} rays>"

    @cached_property
    def area(self) -> Doubles:
        """(p,) areas of the patches."""
        return self._core.area

    @cached_property
    def escaped(self) -> Doubles:
        """(p,) the share of each patch's light that leaves the scene. With it rows sum to 1."""
        return self._core.escaped

    def solve(
        self,
        *,
        emission: Values | None = None,
        reflectance: Values | None = None,
        linear: bool = True,
        solver: str = "auto",
        tolerance: float | None = None,
        threads: int | None = None,
        progress: Progress = None,
    ) -> Solution:
        """The light of the same geometry with other lamps or other paint, without new rays.

        Parameters
        ----------
        emission : radiance, W/(m2 sr): a number, a colour (3,), one for each face (m,) or (m, 3), or a dict from names of
            materials to numbers or colours. That of the scene by default.
        reflectance : the same, 0 to 1.
        linear, solver, tolerance, threads, progress : as in `solve`.

        Lights that are no surfaces stay as they are. The rays went where they lower the error most for the lamps of the scene. With
        other lamps the error is larger, and `standard_error` says by how much.
        """
        options = casting(solver=solver, tolerance=tolerance, linear=linear)
        scene = self.scene
        if emission is not None or reflectance is not None:
            scene = scene.with_values(emission=emission, reflectance=reflectance)
        with shown(progress) as callback:
            return Solution(self._core.solve(scene._core, options, _arrays.threads_of(threads), callback))

    def matrix(self) -> csr_matrix:
        """The form factors as a `scipy.sparse.csr_matrix` (p, p): F[i, j] leaves i and arrives at j.

        `areas[:, None] * F` is symmetric, and rows sum to 1 with `escaped`. Irradiance from a radiosity B is F @ B. The solver
        takes what comes straight from lamps from shadow rays instead, which is more accurate.
        """
        from scipy.sparse import csr_matrix

        values, columns, starts = self._core.rows()
        shape = (len(self), len(self))
        return csr_matrix((values, columns.view(np.int32), starts), shape=shape, copy=False)


def form_factors(
    scene: Scene,
    *,
    error: float | None = None,
    rays: int | None = None,
    patches: int | None = None,
    patch_size: float | None = None,
    quality: str | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
    estimator: str = "pooled",
) -> FormFactors:
    """Cast the form factors of a scene, to solve it with many lightings. Arguments are those of `solve`.

    >>> box = Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
    ...             reflectance=0.5, emission=[1, 0, 0, 0])
    >>> factors = form_factors(box, patches=100, rays=64)
    >>> dim, bright = factors.solve(), factors.solve(emission=[2, 0, 0, 0])
    >>> bool(abs(bright.irradiance / dim.irradiance - 2).max() < 1e-6)
    True
    """
    options = casting(
        error=error,
        rays=rays,
        patches=patches,
        patch_size=patch_size,
        quality=quality,
        estimator=estimator,
        seed=seed,
    )
    with shown(progress) as callback:
        core = _form_factors(_core_of(scene), options, _arrays.threads_of(threads), callback)
    return FormFactors(scene, core)


def _core_of(scene: Scene) -> Any:
    if not isinstance(scene, Scene):
        raise ValueError(f"scene: a radiosity.Scene is wanted, not {type(scene).__name__}")
    return scene._core
