"""View factors against closed forms."""

import subprocess

import numpy as np
import pytest
from conftest import box

import radiosity


def parallel(a, b, c):
    """Between equal rectangles a by b that face each other at distance c (Howell, C-11)."""
    x, y = a / c, b / c
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    inner = np.log(p * q / np.sqrt(1 + x * x + y * y))
    inner += x * q * np.arctan(x / q) + y * p * np.arctan(y / p) - x * np.arctan(x) - y * np.arctan(y)
    return 2 * inner / (np.pi * x * y)


def test_a_room_is_closed_reciprocal_and_right():
    size = (2.0, 1.5, 3.0)
    vertices, faces = box(size)
    result = radiosity.view_factors(vertices, faces)
    F, standard_error = result
    assert result.enclosed and F.shape == standard_error.shape == (6, 6)
    assert F.sum(axis=1) == pytest.approx(np.ones(6), abs=1e-12)
    exchange = result.area[:, None] * F
    assert exchange == pytest.approx(exchange.T, abs=1e-12)
    # The formula is accurate to 1e-5 where nothing is in between, and closure shares out what rows miss by it.
    assert F[0, 1] == pytest.approx(parallel(size[0], size[2], size[1]), rel=2e-5)
    assert np.array_equal(np.asarray(result), F) and result[0, 1] == F[0, 1]
    assert result.names == [str(i) for i in range(6)]


def test_rows_are_what_leaves():
    """A small plate before a large one: nearly all of the small one's light arrives at the large one."""
    small = [[-0.1, 0, -0.1], [-0.1, 0, 0.1], [0.1, 0, 0.1], [0.1, 0, -0.1]]
    large = [[-5, 0.2, -5], [5, 0.2, -5], [5, 0.2, 5], [-5, 0.2, 5]]
    F, _ = radiosity.view_factors([small, large])
    assert F[0, 1] > 0.99 and F[1, 0] == pytest.approx(F[0, 1] * 0.04 / 100, rel=1e-9)


def test_every_form_of_surfaces_gives_the_same():
    pv, trimesh = pytest.importorskip("pyvista"), pytest.importorskip("trimesh")
    vertices, faces = box()
    F, _ = radiosity.view_factors(vertices, faces)
    forms = [
        radiosity.Scene(vertices, faces),
        [vertices[face] for face in faces],
        [vertices[face].astype(np.float32).tolist() for face in faces],
        pv.PolyData(vertices, np.column_stack([np.full(6, 4), faces]).ravel()),
    ]
    for form in forms:
        assert np.array_equal(radiosity.view_factors(form).F, F)
    cube = trimesh.Trimesh(vertices, faces=[[f[0], f[k], f[k + 1]] for f in faces for k in (1, 2)], process=False)
    by_triangle = radiosity.view_factors(cube)
    summed = by_triangle.F.reshape(12, 6, 2).sum(axis=2).reshape(6, 2, 6).mean(axis=1)
    assert summed == pytest.approx(F, abs=2e-5)


def test_obstacles_block_and_are_no_surfaces():
    """A plate as large as the two squares, halfway between them, hides one from the other."""
    floor = [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]
    roof = [[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]]
    half = [[0, 0.5, 0], [1, 0.5, 0], [1, 0.5, 1], [0, 0.5, 1]]
    result = radiosity.view_factors([floor, roof], obstacles=[half])
    assert len(result) == 2 and result.F.max() < 1e-6
    # Both see the plate, and around it the sky and the ground.
    backs = result.backs
    assert (abs(backs.value - parallel(1, 1, 0.5)) < 4 * backs.standard_error + 1e-4).all() and (backs.standard_error < 0.03).all()
    assert result.escaped == pytest.approx([1, 1])
    again = radiosity.view_factors([floor, roof], obstacles=(np.array(half), [[0, 1, 2, 3]]))
    assert np.array_equal(again.F, result.F)
    scene = radiosity.Scene(np.vstack([floor, roof, half]), np.arange(12).reshape(3, 4), materials=["a", "b", "plate"])
    named = radiosity.view_factors(scene, obstacles=["plate"])
    assert np.array_equal(named.F[:2, :2], result.F) and named.F.shape == (3, 3) and not named.F[2].any()
    with pytest.raises(ValueError, match="^obstacles"):
        radiosity.view_factors(scene, obstacles=["plates"])


def test_sky_and_ground():
    """A wall on an endless plane without a ground sees half sky and half ground; a floor sees only sky."""
    wall = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    far = [[50, 0, 0], [50, 0, 1], [51, 0, 1], [51, 0, 0]]
    result = radiosity.view_factors([wall, far])
    assert result.sky.value == pytest.approx([0.5, 1.0], abs=3e-3)
    assert result.ground.value == pytest.approx([0.5, 0.0], abs=3e-3)
    turned = radiosity.view_factors([wall, far], up=[0, -1, 0])
    assert turned.ground.value == pytest.approx(result.sky.value, abs=6e-3)


def test_faces_without_area_have_empty_rows():
    vertices, faces = box()
    more = np.vstack([faces[:2], [[0, 0, 0, 0]], faces[2:]])
    result = radiosity.view_factors(vertices, more)
    assert result.F.shape == (7, 7) and not result.F[2].any() and not result.F[:, 2].any() and result.area[2] == 0
    kept = [0, 1, 3, 4, 5, 6]
    assert result.F[np.ix_(kept, kept)] == pytest.approx(radiosity.view_factors(vertices, faces).F)


def test_groups_and_sides():
    vertices, faces = box()
    scene = radiosity.Scene(vertices, faces, materials=["floor", "roof", "wall", "wall", "wall", "wall"])
    result = radiosity.view_factors(scene, by="material")
    assert result.names == ["floor", "roof", "wall"] and result.area == pytest.approx([1, 1, 4])
    assert result.F[0, 1] == pytest.approx(parallel(1, 1, 1), rel=2e-5)
    outside = radiosity.view_factors(scene, side="back")
    assert outside.F.max() == 0
    # A plate over a floor that shows it its back.
    plate = [[[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]]]
    with pytest.warns(UserWarning, match="100.0 % of what surfaces see are backs"):
        radiosity.view_factors(plate)
    both = radiosity.view_factors(scene, side="both")
    assert both.F.shape == (12, 12) and both.F[:6, :6] == pytest.approx(radiosity.view_factors(scene).F)


def test_the_sparse_matrix_is_the_dense_one():
    pytest.importorskip("scipy")
    vertices, faces = box()
    for faces in (faces, np.vstack([faces, [[1, 1, 1, 1]]])):
        result = radiosity.view_factors(vertices, faces)
        assert np.array_equal(result.matrix().toarray(), result.F)


def test_matrices_are_those_of_the_command_line(tmp_path):
    path = tmp_path / "room.obj"
    vertices, faces = box((2, 1, 1))
    blocker = np.array([[0.7, 0.2, 0.2], [1.1, 0.2, 0.2], [1.1, 0.7, 0.6], [0.7, 0.7, 0.6]])
    lines = ["v " + " ".join(map(repr, map(float, v))) for v in np.vstack([vertices, blocker])]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in [*faces, [8, 9, 10, 11], [11, 10, 9, 8]]]
    path.write_text("\n".join(lines) + "\n")
    out = tmp_path / "f.npy"
    subprocess.run(["radiosity", "view-factors", path, "-o", out, "--quiet", "--error", "1e-3", "--seed", "5"], check=True)
    scene = radiosity.Scene.load(path, reflectance=0.5)
    result = radiosity.view_factors(scene, error=1e-3, seed=5, threads=1)
    assert np.load(out).tobytes() == np.ascontiguousarray(result.F).tobytes()
    assert 0 < result.error <= 1e-3 and result.rays > 0


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"surfaces": 5}, "surfaces"),
        ({"surfaces": []}, "surfaces"),
        ({"surfaces": [[[0, 0], [1, 1], [0, 1]]]}, "surfaces"),
        ({"error": 1e-9}, "error"),
        ({"by": "colour"}, "by"),
        ({"by": "group"}, "by"),
        ({"side": "left"}, "side"),
        ({"up": [0, 0]}, "up"),
        ({"up": [0, 0, 0]}, "up"),
        ({"obstacles": 3}, "obstacles"),
        ({"faces": [[0, 1, 7]]}, "faces"),
    ],
)
def test_wrong_arguments_are_named(arguments, name):
    good = {"surfaces": [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]}
    if "faces" in arguments:
        good["surfaces"] = good["surfaces"][0]
    with pytest.raises(ValueError, match=f"^{name}"):
        radiosity.view_factors(**(good | arguments))


def test_a_room_that_is_none_is_refused():
    with pytest.raises(ValueError, match="do not enclose a room"):
        radiosity.view_factors(*(box()[0], box()[1][:5]), enclosed=True)
