"""Scenes: triangles with reflectance and emission."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arrays, _words
from ._arrays import Doubles
from ._radiosity import Scene as _Scene
from ._words import Sky

Values = npt.ArrayLike | Mapping[str, npt.ArrayLike]
"""A value for all faces, for each face, or for materials by their names."""


class Scene:
    """Triangles and polygons that reflect light diffusely, and may emit it.

    Parameters
    ----------
    vertices : (n, 3) positions, in any unit of length.
    faces : (m, 3) or (m, k) indices of vertices, or a list of faces with three or more indices each. The front of a face is the
        side from which its corners run counter-clockwise.
    reflectance : share of light that both sides of a face reflect, 0 to 1: one number, one colour (3,), or one for each
        face, (m,) or (m, 3).
    emission : radiance that the fronts emit, W/(m2 sr), in the same forms. A lamp of radiance L emits pi L W/m2.
    materials : a name for each face, to address faces by.
    photometric : whether radiance is luminance, cd/m2, and light is in lm and lx instead of W and W/m2.

    Vertices at equal positions are joined. Triangles without area are left out. Of faces that overlap in one plane, the smaller
    one is in front. Sun and sky are added by `with_lights`.

    >>> import numpy as np
    >>> square = Scene([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]], reflectance=0.5, emission=[1, 2, 3])
    >>> square.triangles.shape
    (2, 3)
    >>> square.face_of_triangles
    array([0, 0])
    """

    _core: _Scene

    def __init__(
        self,
        vertices: npt.ArrayLike,
        faces: Any,
        reflectance: npt.ArrayLike = 0.5,
        emission: npt.ArrayLike = 0.0,
        *,
        materials: Sequence[str] | None = None,
        photometric: bool = False,
    ) -> None:
        places = _arrays.points("vertices", vertices)
        corners, sizes = _arrays.polygons(faces, len(places))
        m = len(sizes)
        rho = _arrays.colours("reflectance", reflectance, m)
        radiance = _arrays.colours("emission", emission, m)
        _check_range(rho, radiance)
        if materials is None:
            names, material = ["faces"], np.zeros(m, dtype=np.uint32)
        else:
            if isinstance(materials, str) or len(materials) != m:
                raise ValueError(f"materials: a name for each of the {m} faces is wanted")
            names = list(dict.fromkeys(str(name) for name in materials))
            numbers = {name: k for k, name in enumerate(names)}
            material = np.array([numbers[str(name)] for name in materials], dtype=np.uint32)
        self._core = _Scene(places, corners, sizes, material, names, rho, radiance, photometric)
        self._warn()

    @classmethod
    def _of(cls, core: _Scene) -> Scene:
        scene = cls.__new__(cls)
        scene._core = core
        return scene

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        reflectance: Values | None = None,
        emission: Values | None = None,
        ignore: Sequence[str] = (),
        emitters: Sequence[str] | None = None,
        models: Mapping[str, str] | None = None,
        specular: str = "drop",
        unlit_emits: bool = False,
        sun: Sequence[float] | None = None,
        sky: Sky | None = None,
        sky_rotation: float | None = None,
        place: Sequence[float] | None = None,
        at: datetime | str | None = None,
        luminaires: Sequence[tuple[str | os.PathLike[str], Sequence[float]]] = (),
        lights: str | os.PathLike[str] | None = None,
        up: str | None = None,
        photometric: bool = False,
        luminous_efficacy: float | None = None,
    ) -> Scene:
        """Read a scene from an .obj (with its .mtl), .gltf, .glb, .ply or .stl file.

        Parameters
        ----------
        path : the file.
        reflectance : a number or colour for surfaces that have none in the file, or a dict from names of materials to
            reflectances, 0 to 1.
        emission : a radiance, W/(m2 sr), that all materials emit, or a dict from names of materials to radiances.
        ignore : materials whose faces are left out, for example window panes.
        emitters : the only materials and lights that emit; the lights of `sun` and `sky` are named so.
        models : specular parts by names of materials, as in {"floor": "ward:0.2,0.1,0.1"}, for path and light tracing.
        specular : what to do with specular parts where surfaces count as diffuse: "drop" them, or count them as "diffuse".
        unlit_emits : whether unlit materials of glTF emit their colour.
        sun, sky, sky_rotation, place, at, luminaires, lights, up : as in `with_lights`. Without `lights`, a file lights.toml
            beside the scene is taken if there is one.
        photometric : whether light is in lm, cd, lx and cd/m2 instead of W, W/sr, W/m2 and W/(m2 sr).
        luminous_efficacy : the lumens of a watt, by which the candela of photometric files are divided otherwise.

        Raises FileNotFoundError, and ValueError with file and line for a file that cannot be used.
        """
        words = _words.of_scene(
            path,
            _words.of_lights(
                sun=sun,
                sky=sky,
                sky_rotation=sky_rotation,
                place=place,
                at=at,
                luminaires=luminaires,
                lights=lights,
                up=up,
            ),
            reflectance=reflectance,
            emission=emission,
            ignore=ignore,
            emitters=emitters,
            models=models,
            specular=specular,
            unlit_emits=unlit_emits,
            photometric=photometric,
            luminous_efficacy=luminous_efficacy,
        )
        with _words.arguments_named():
            scene = cls._of(_Scene.load(os.fspath(path), words))
        scene._warn()
        return scene

    def with_lights(
        self,
        *,
        sun: Sequence[float] | None = None,
        sky: Sky | None = None,
        sky_rotation: float | None = None,
        place: Sequence[float] | None = None,
        at: datetime | str | None = None,
        luminaires: Sequence[tuple[str | os.PathLike[str], Sequence[float]]] = (),
        lights: str | os.PathLike[str] | None = None,
        up: str | None = None,
    ) -> Scene:
        """The same scene with more lights that are no surfaces: sun, sky, luminaires.

        Parameters
        ----------
        sun : (azimuth, altitude, irradiance): degrees clockwise from north as seen from above, degrees above the horizon, and
            W/m2 on a plane that faces the sun. (azimuth, altitude) only says where the sun of the sky is.
        sky : ("uniform", radiance), W/(m2 sr); ("overcast", E), ("clear", E) or ("intermediate", E) of the CIE, with the
            irradiance E, W/m2, on an unobstructed horizontal plane; ("perez", direct normal, diffuse horizontal), W/m2, which
            brings the sun too; or the path of an image of all directions, .hdr or .exr. A sky replaces an earlier one.
        sky_rotation : turns the image of the sky clockwise as seen from above, degrees.
        place, at : (latitude, longitude) in degrees, and a time with its offset from UTC, a `datetime` or
            "2026-06-21T12:00+02:00": where the sun of the sky is.
        luminaires : pairs of a photometric file, .ies or .ldt, and the position (3,) at which it hangs.
        lights : a light file, .toml.
        up : the axis that is up for sun and sky, "y" (the default; north is -z) or "z" (north is +y). East is +x.

        >>> square = Scene([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], [[0, 1, 2, 3]])  # faces up
        >>> lit = square.with_lights(sun=(180, 30, 800), sky=("uniform", 10))
        >>> lit.lights
        ['sun', 'sky']
        >>> import radiosity
        >>> E = radiosity.solve(lit, patches=8, rays=64).by_face()[0, 0]
        >>> bool(abs(E - (800 * 0.5 + 10 * np.pi)) < 1e-3 * E)
        True
        """
        words = _words.of_lights(
            sun=sun,
            sky=sky,
            sky_rotation=sky_rotation,
            place=place,
            at=at,
            luminaires=luminaires,
            lights=lights,
            up=up,
        )
        with _words.arguments_named():
            return Scene._of(self._core.lit(words))

    @property
    def lights(self) -> list[str]:
        """Names of the lights that are no surfaces."""
        return self._core.lights

    @classmethod
    def from_trimesh(
        cls, mesh: Any, reflectance: npt.ArrayLike = 0.5, emission: npt.ArrayLike = 0.0
    ) -> Scene:
        """A scene from a `trimesh.Trimesh`, or from a `trimesh.Scene` with all its transforms applied.

        Reflectance and emission are as for `Scene`; of a `trimesh.Scene` they may also be dicts from the names of its geometries
        to values. Geometries become materials.
        """
        return cls._of_parts(_trimesh_parts(mesh), reflectance, emission)

    @classmethod
    def from_pyvista(
        cls, mesh: Any, reflectance: npt.ArrayLike = 0.5, emission: npt.ArrayLike = 0.0
    ) -> Scene:
        """A scene from a `pyvista.PolyData`, a `pyvista.MultiBlock` of them, or the outer surface of another data set.

        Polygons stay faces. Reflectance and emission are as for `Scene`, or the names of arrays of the cells; of a
        `MultiBlock` they may also be dicts from the names of its blocks to values. Blocks become materials.
        """
        surfaces = _pyvista_surfaces(mesh)

        def by_cells(values: Any, name: str) -> Any:
            if not isinstance(values, str):
                return values
            try:
                return np.concatenate([np.asarray(surface.cell_data[values]) for _, surface in surfaces])
            except KeyError:
                raise ValueError(f"{name}: the mesh has no cell array {values!r}") from None

        parts = [(name, surface.points, _split(np.asarray(surface.faces))) for name, surface in surfaces]
        return cls._of_parts(parts, by_cells(reflectance, "reflectance"), by_cells(emission, "emission"))

    @classmethod
    def _of_parts(cls, parts: list[tuple[str, Any, list[Any]]], reflectance: Any, emission: Any) -> Scene:
        places, faces, names = _joined(parts)

        def values(given: Any, argument: str, default: float) -> Any:
            if not isinstance(given, Mapping):
                return given
            for name in given:
                if name not in names:
                    raise ValueError(f"{argument}: there is no part {name!r}; the parts are {sorted(set(names))}")
            return np.array([_arrays.colour(argument, given.get(name, default)) for name in names])

        return cls(
            places,
            faces,
            values(reflectance, "reflectance", 0.5),
            values(emission, "emission", 0.0),
            materials=names,
        )

    def with_values(self, *, reflectance: Values | None = None, emission: Values | None = None) -> Scene:
        """The same geometry with another reflectance (0 to 1) or emission (W/(m2 sr)).

        Values are one number, one colour (3,), one for each face (m,) or (m, 3), or a dict from names of materials to numbers
        or colours; materials that it does not name keep what they have.
        """
        rho, radiance = self._by_face("reflectance", reflectance), self._by_face("emission", emission)
        _check_range(np.zeros(3) if rho is None else rho, np.zeros(3) if radiance is None else radiance)
        return Scene._of(self._core.painted(rho, radiance))

    def _by_face(self, argument: str, values: Values | None) -> Doubles | None:
        if values is None:
            return None
        m = len(self)
        if not isinstance(values, Mapping):
            return _arrays.colours(argument, values, m)
        table = self._core.materials
        names = {name for name, _, _ in table}
        rows = [rho if argument == "reflectance" else radiance for _, rho, radiance in table]
        for name, value in values.items():
            if name not in names:
                raise ValueError(f"{argument}: no face has material {name!r}; its materials are {sorted(names)}")
            for k, entry in enumerate(table):
                if entry[0] == name:
                    rows[k] = _arrays.colour(f"{argument}[{name!r}]", value)
        result = np.zeros((m, 3))
        result[self.face_of_triangles] = np.array(rows)[self._core.material_of_triangles]
        return result

    def _warn(self) -> None:
        for warning in self._core.warnings:
            warnings.warn(warning, stacklevel=3)

    def __len__(self) -> int:
        """Number of faces."""
        return self._core.faces

    def __repr__(self) -> str:
        return f"<radiosity.Scene {self._core.name}: {len(self)} faces, {len(self.triangles)} triangles>"

    @property
    def vertices(self) -> Doubles:
        """(n, 3) positions; equal positions are one vertex."""
        return self._core.vertices.reshape(-1, 3)

    @property
    def triangles(self) -> npt.NDArray[np.uint32]:
        """(t, 3) indices of vertices. Faces are cut into triangles, also along the lines where other faces touch or cross them."""
        return self._core.triangles.reshape(-1, 3)

    @property
    def face_of_triangles(self) -> npt.NDArray[np.int64]:
        """(t,) the face that each triangle is of."""
        return self._core.face_of_triangles.view(np.int64)

    @property
    def area(self) -> Doubles:
        """(m,) areas of the faces."""
        return _arrays.sums(self.face_of_triangles, self._core.area, len(self))

    @property
    def materials(self) -> dict[str, tuple[tuple[float, ...], tuple[float, ...]]]:
        """Names of materials, with reflectance (R, G, B) and emitted radiance (R, G, B) of the first of each name."""
        table: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {}
        for name, rho, radiance in self._core.materials:
            table.setdefault(name, (tuple(rho), tuple(radiance)))
        return table


def _check_range(reflectance: Doubles, emission: Doubles) -> None:
    if reflectance.size and not (0 <= reflectance.min() and reflectance.max() <= 1):
        raise ValueError("reflectance: values from 0 to 1 are wanted")
    if emission.size and not (0 <= emission.min() and emission.max() <= 1e100):
        raise ValueError("emission: values from 0 to 1e100 are wanted")


def _split(faces: npt.NDArray[Any]) -> list[Any]:
    """The faces in VTK's list of a size and so many corners, again and again."""
    if len(faces) and len(faces) % (faces[0] + 1) == 0:
        table = faces.reshape(-1, faces[0] + 1)
        if (table[:, 0] == faces[0]).all():
            return list(table[:, 1:])
    parts = []
    at = 0
    while at < len(faces):
        parts.append(faces[at + 1 : at + 1 + faces[at]])
        at += 1 + int(faces[at])
    return parts


Part = tuple[str, Any, list[Any]]
"""Name, vertices and faces of a part of a mesh."""


def _trimesh_parts(mesh: Any) -> list[Part]:
    if hasattr(mesh, "geometry"):
        parts = []
        for node in mesh.graph.nodes_geometry:
            transform, name = mesh.graph[node]
            part = mesh.geometry[name].copy()
            part.apply_transform(transform)
            parts.append((str(name), part.vertices, list(np.asarray(part.faces))))
        return parts
    if hasattr(mesh, "faces"):
        return [("faces", mesh.vertices, list(np.asarray(mesh.faces)))]
    raise ValueError(f"mesh: a trimesh.Trimesh or trimesh.Scene is wanted, not {type(mesh).__name__}")


def _pyvista_surfaces(mesh: Any) -> list[tuple[str, Any]]:
    """The surfaces of all blocks, without lines and points, with strips as triangles."""
    if hasattr(mesh, "n_blocks"):
        blocks = [(str(name), mesh[name]) for name in mesh.keys() if mesh[name] is not None]
    elif hasattr(mesh, "n_cells"):
        blocks = [("faces", mesh)]
    else:
        raise ValueError(f"mesh: a data set of pyvista is wanted, not {type(mesh).__name__}")
    surfaces = [(name, b if hasattr(b, "is_all_triangles") else b.extract_surface()) for name, b in blocks]
    plain = [(name, s) for name, s in surfaces if not (s.n_strips or s.n_verts or s.n_lines)]
    return plain if len(plain) == len(surfaces) else [(name, s.triangulate()) for name, s in surfaces]


def _joined(parts: list[Part]) -> tuple[Doubles, list[Any], list[str]]:
    """Vertices and faces of all parts, and the name of the part that each face is of."""
    places: list[Doubles] = []
    faces: list[Any] = []
    names: list[str] = []
    first = 0
    for name, vertices, corners in parts:
        places.append(_arrays.points("mesh", vertices))
        faces += [np.asarray(face) + first for face in corners]
        names += [name] * len(corners)
        first += len(vertices)
    if not faces:
        raise ValueError("mesh: there is no face")
    return np.concatenate(places), faces, names
