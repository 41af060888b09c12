"""Scenes from arrays, files and meshes of other packages."""

import datetime
import subprocess

import numpy as np
import pytest
from conftest import box

import radiosity


def test_arrays_of_every_kind_give_the_same_scene():
    vertices, faces = box()
    plain = radiosity.Scene(vertices, faces, 0.5, [0, 1, 0, 0, 0, 0])
    wide = np.zeros((8, 6))
    wide[:, ::2] = vertices
    frozen = vertices.copy()
    frozen.flags.writeable = False
    for places in (vertices.astype(np.float32), vertices.tolist(), wide[:, ::2], np.asfortranarray(vertices), frozen):
        for corners in (faces, faces.tolist(), faces.astype(np.int16), faces.astype(float), [tuple(f) for f in faces]):
            scene = radiosity.Scene(places, corners, np.float32(0.5), np.eye(6, dtype=np.float32)[1])
            assert np.array_equal(scene.vertices, plain.vertices)
            assert np.array_equal(scene.triangles, plain.triangles)
            assert scene.materials == plain.materials
    assert len(plain) == 6 and plain.triangles.shape == (12, 3)
    assert plain.area == pytest.approx(np.ones(6))


def test_faces_have_their_own_values_and_names():
    vertices, faces = box()
    names = ["floor", "lamp", "wall", "wall", "wall", "wall"]
    rho = np.linspace(0.1, 0.6, 6)
    scene = radiosity.Scene(vertices, faces, rho, np.eye(6)[:, 1:2] * [1, 2, 3], materials=names)
    assert scene.materials["lamp"] == ((0.2,) * 3, (1.0, 2.0, 3.0))
    patches = radiosity.solve(scene, patches=12, rays=16).patches
    assert patches.reflectance[:, 0] == pytest.approx(rho[patches.parent])
    assert patches.emission[patches.parent == 1] == pytest.approx(np.pi * np.tile([1.0, 2, 3], (2, 1)))
    darker = scene.with_values(reflectance={"wall": 0.05}, emission={"lamp": 7})
    assert darker.materials["wall"][0] == (0.05,) * 3 and darker.materials["floor"][0] == (0.1,) * 3
    assert darker.materials["lamp"][1] == (7.0,) * 3
    assert scene.materials["lamp"][1] == (1.0, 2.0, 3.0)


def test_faces_of_mixed_sizes():
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]]
    scene = radiosity.Scene(vertices, [[0, 3, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    assert scene.face_of_triangles.tolist() == [0, 0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"vertices": [[0, 0], [1, 0]]}, "vertices"),
        ({"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, np.nan]]}, "vertices"),
        ({"vertices": "no"}, "vertices"),
        ({"faces": [[0, 1]]}, "faces"),
        ({"faces": [[0, 1, 3]]}, "faces"),
        ({"faces": [[0, 1, -1]]}, "faces"),
        ({"faces": [[0, 1, 1.5]]}, "faces"),
        ({"faces": []}, "faces"),
        ({"faces": 3}, "faces"),
        ({"faces": [[0, 1, 2], [0, 1]]}, "faces"),
        ({"faces": [["a", "b", "c"]]}, "faces"),
        ({"reflectance": 1.1}, "reflectance"),
        ({"reflectance": [0.1, 0.2]}, "reflectance"),
        ({"reflectance": None}, "reflectance"),
        ({"emission": -1}, "emission"),
        ({"emission": np.inf}, "emission"),
        ({"emission": np.ones((2, 3))}, "emission"),
        ({"materials": "lamp"}, "materials"),
        ({"materials": ["a", "b"]}, "materials"),
    ],
)
def test_what_is_wrong_is_a_value_error_with_its_name(arguments, name):
    good = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    with pytest.raises(ValueError, match=f"^{name}"):
        radiosity.Scene(**(good | arguments))


def test_files(cornell, cornell_path, tmp_path):
    assert "light" in cornell.materials and max(cornell.materials["light"][1]) > 0
    changed = radiosity.Scene.load(cornell_path, emission={"light": 5}, reflectance={"light": [0.1, 0.2, 0.3]})
    assert changed.materials["light"] == ((0.1, 0.2, 0.3), (5.0, 5.0, 5.0))
    fewer = radiosity.Scene.load(cornell_path, ignore=["light"])
    assert len(fewer.triangles) < len(cornell.triangles)
    with pytest.raises(FileNotFoundError) as missing:
        radiosity.Scene.load(tmp_path / "none.obj")
    assert missing.value.filename == str(tmp_path / "none.obj")
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nf 1 2 9\n")
    with pytest.raises(ValueError, match=r"bad\.obj:3"):
        radiosity.Scene.load(tmp_path / "bad.obj")
    for argument in ("ignore", "emitters"):
        with pytest.raises(ValueError, match=f"^{argument}"):
            radiosity.Scene.load(cornell_path, **{argument: ["nothing"]})
    with pytest.raises(ValueError, match="^emission"):
        radiosity.Scene.load(cornell_path, emission={"nothing": 1})
    with pytest.raises(ValueError, match="^scene: nothing emits light"):
        radiosity.solve(radiosity.Scene(*box()))


def test_sun_and_sky_light_a_plane():
    """A plane that nothing shades: E = E_sun sin(altitude) + pi L, and the irradiance of a CIE sky is what it was said to be."""
    plane = radiosity.Scene([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], [[0, 1, 2, 3]], 0.3)
    lit = plane.with_lights(sun=(200, 30, 800), sky=("uniform", 7))
    assert lit.lights == ["sun", "sky"] and plane.lights == []
    E = radiosity.solve(lit, patches=8, rays=64)
    assert E.irradiance[E.patches.front] == pytest.approx(800 * 0.5 + 7 * np.pi, rel=1e-3)
    assert E.ledger["entered"] == pytest.approx([E.by_face()[0, 0]] * 3, rel=1e-9)
    for sky in (("overcast", 120), "clear:120"):
        mean, standard_error = radiosity.probe(plane.with_lights(sun=(200, 30), sky=sky), [[0.5, 0, 0.5]], [0, 1, 0])
        assert (abs(mean - 120) < 4 * standard_error + 0.01).all() and (standard_error < 1).all()
    # With z up the same plane stands: the sun in the west, 30 degrees above the ground, is seen by another face.
    wall = radiosity.Scene([[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]], [[0, 1, 2, 3]]).with_lights(sun=(270, 30, 800), up="z")
    E = radiosity.solve(wall, patches=8, rays=64)
    assert E.irradiance[E.patches.front] == pytest.approx(800 * np.cos(np.radians(30)), rel=1e-3)


def test_a_file_with_lights_is_that_of_the_command_line(cornell_path, tmp_path):
    at = datetime.datetime(2026, 6, 21, 12, 0, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    scene = radiosity.Scene.load(
        cornell_path,
        sky=("perez", 700, 120.5),
        place=(48, 11),
        at=at,
        emission={"white": [0.1, 0.2, 0.3]},
        emitters=["sky", "white"],
    )
    assert scene.lights == ["sky"] and scene.materials["light"][1] == (0, 0, 0)
    radiosity.solve(scene, patches=200, rays=32).save(tmp_path / "python.ply")
    command = ["radiosity", "solve", cornell_path, "--sky", "perez:700,120.5", "--place", "48,11", "--at", "2026-06-21T12:00+02:00",
               "--emit", "0.1,0.2,0.3@white", "--emitters", "sky,white", "--patches", "200", "--rays", "32", "--quiet",
               "-o", tmp_path / "cli.ply"]
    subprocess.run(command, check=True)
    assert (tmp_path / "cli.ply").read_bytes() == (tmp_path / "python.ply").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"sun": [1]}, "sun"),
        ({"sun": [0, 100, 5]}, "sun"),
        ({"sun": [0, 10]}, "the position of the sun has no effect"),
        ({"sky": "blue"}, "sky"),
        ({"sky": ("uniform", -1)}, "sky"),
        ({"sky": ("clear", 100)}, "sky"),
        ({"sky": "uniform:1", "sky_rotation": 3}, "sky_rotation"),
        ({"place": [100, 200], "at": "2026-06-21T12:00Z", "sky": "clear:1"}, "place"),
        ({"place": [1, 2], "at": "noon", "sky": "clear:1"}, "at"),
        ({"luminaires": ["lamp.ies"]}, "luminaires"),
        ({"up": "x"}, "up"),
    ],
)
def test_wrong_lights_are_named(cornell, arguments, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        cornell.with_lights(**arguments)


def test_walls_that_stand_on_a_floor_cut_it():
    """A floor under a wall is cut where the wall stands, and keeps its number as a face."""
    floor = [[0, 0, 0], [0, 0, 2], [2, 0, 2], [2, 0, 0]]
    wall = [[0.7, 0, 0], [0.7, 1, 0], [0.7, 1, 2], [0.7, 0, 2]]
    scene = radiosity.Scene(floor + wall, [[0, 1, 2, 3], [4, 5, 6, 7]], emission=[0, 1])
    assert len(scene) == 2 and len(scene.triangles) > 4 and scene.area == pytest.approx([4, 2])
    corners = scene.vertices[scene.triangles[scene.face_of_triangles == 0]][:, :, 0]
    assert ((corners <= 0.7 + 1e-12).all(axis=1) | (corners >= 0.7 - 1e-12).all(axis=1)).all()


def test_warnings_of_a_scene_are_warnings():
    with pytest.warns(UserWarning, match="1 triangles without area"):
        radiosity.Scene([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]])


def test_trimesh():
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box(extents=(1, 2, 3))
    scene = radiosity.Scene.from_trimesh(mesh, emission=1)
    assert len(scene) == 12 and scene.area.sum() == pytest.approx(22)
    both = trimesh.Scene()
    both.add_geometry(mesh, geom_name="big")
    both.add_geometry(trimesh.creation.icosphere(subdivisions=1), geom_name="ball",
                      transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene = radiosity.Scene.from_trimesh(both, emission={"ball": 2}, reflectance={"big": 0.2})
    assert scene.materials["ball"] == ((0.5,) * 3, (2.0,) * 3)
    assert scene.materials["big"] == ((0.2,) * 3, (0.0,) * 3)
    assert scene.vertices[:, 0].max() == pytest.approx(6)
    with pytest.raises(ValueError, match="^emission"):
        radiosity.Scene.from_trimesh(both, emission={"cone": 2})
    with pytest.raises(ValueError, match="^mesh"):
        radiosity.Scene.from_trimesh(np.zeros((3, 3)))


def test_pyvista():
    pv = pytest.importorskip("pyvista")
    cube = pv.Cube()
    scene = radiosity.Scene.from_pyvista(cube)
    assert len(scene) == 6 and scene.area == pytest.approx(np.ones(6))
    sphere = pv.Sphere()
    sphere.cell_data["rho"] = np.linspace(0, 1, sphere.n_cells)
    scene = radiosity.Scene.from_pyvista(sphere, reflectance="rho")
    assert len(scene) == sphere.n_cells
    strips = radiosity.Scene.from_pyvista(sphere.strip())
    assert strips.area.sum() == pytest.approx(scene.area.sum())
    grid = radiosity.Scene.from_pyvista(pv.ImageData(dimensions=(3, 3, 3)))
    assert grid.area.sum() == pytest.approx(24)
    blocks = pv.MultiBlock({"lamp": cube, "other": pv.Plane(center=(0, 0, 3))})
    scene = radiosity.Scene.from_pyvista(blocks, emission={"lamp": 4})
    assert scene.materials["lamp"][1] == (4.0,) * 3 and scene.materials["other"][1] == (0.0,) * 3
    with pytest.raises(ValueError, match="^reflectance"):
        radiosity.Scene.from_pyvista(sphere, reflectance="none")
