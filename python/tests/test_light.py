"""Probes, pictures, lightmaps and validation."""

import json
import subprocess

import numpy as np
import pytest
from conftest import box

import radiosity


def test_probes_agree_with_the_closed_form():
    """Below a square lamp, beside it and with a turned normal: the view factor of a point (Howell, B-4) times pi L."""
    lamp = radiosity.Scene([[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]], [[0, 1, 2, 3]], emission=[1, 2, 4])
    a = 1.0
    corner = 2 * a / np.sqrt(1 + a * a) * np.arctan(a / np.sqrt(1 + a * a)) / (2 * np.pi)
    E, standard_error = radiosity.probe(lamp, [[0, 0, 0], [1, 0, 1]], [0, 1, 0], samples=4096)
    assert E == pytest.approx(np.pi * corner * np.tile([1.0, 2, 4], (2, 1)), rel=1e-3)
    assert (standard_error < 1e-3 * E).all()
    down = radiosity.probe(lamp, np.array([[0.5, 0, 0.5]], dtype=np.float32), [[0, -1, 0]], samples=16)
    assert not down.irradiance.any()


def test_probes_are_those_of_the_command_line(cornell, cornell_path, tmp_path):
    points = np.array([[420.0, 0, 100], [300, 200, 300]])
    normals = np.array([[0.0, 1, 0], [0, 0, 1]])
    np.savetxt(tmp_path / "points.txt", np.hstack([points, normals]))
    for method, source in (("path", cornell), ("radiosity", radiosity.solve(cornell, patches=300, rays=32))):
        command = ["radiosity", "probe", cornell_path, "--points", tmp_path / "points.txt", "--spp", "256", "--quiet",
                   "-o", tmp_path / "out.txt", "--method", method]
        command += ["--patches", "300", "--rays", "32"] if method == "radiosity" else []
        subprocess.run(command, check=True)
        E, standard_error = radiosity.probe(source, points, normals, samples=256, threads=1)
        # The table has ten digits.
        values = [[f"{x:.9e}" for x in row] for row in np.hstack([E, standard_error])]
        table = [line.split()[6:] for line in (tmp_path / "out.txt").read_text().splitlines()]
        assert [[float(x) for x in row] for row in table] == [[float(x) for x in row] for row in values]


def test_buried_points_are_warned_of():
    scene = radiosity.Scene(*box(), emission=[0, 1, 0, 0, 0, 0])
    with pytest.warns(UserWarning, match="1 points lie below a surface"):
        radiosity.probe(scene, [[0.5, -0.01, 0.5], [0.5, 0, 0.5]], [0, 1, 0], samples=16)


def test_pictures(cornell, solution):
    paths = radiosity.render(cornell, width=32, height=24, samples=64)
    light = radiosity.render(cornell, width=32, height=24, samples=256, method="light")
    shown = radiosity.render(solution, width=32, height=24, samples=8)
    gathered = radiosity.render(solution, width=32, height=24, samples=16, final_gather=2)
    assert paths.shape == (24, 32, 3) and paths.dtype == np.float32
    # Means over the picture without the lamp, which is brighter than all else: their noise is about 0.5 %, patches are coarse.
    lamp = paths.max(axis=2) > 1
    for other in (light, shown, gathered):
        assert other[~lamp].mean() == pytest.approx(paths[~lamp].mean(), rel=0.03)
    again = radiosity.render(cornell, width=32, height=24, samples=64, threads=1)
    assert np.array_equal(again, paths)
    eight = radiosity.to_srgb(paths)
    assert eight.shape == paths.shape and eight.dtype == np.uint8 and eight.max() == 255
    assert (radiosity.to_srgb(paths, stops=2) >= eight).all()


def test_a_picture_is_that_of_the_command_line(cornell, cornell_path, tmp_path):
    image = pytest.importorskip("PIL.Image")
    out = tmp_path / "p.png"
    command = ["radiosity", "render", cornell_path, "-o", out, "--width", "16", "--height", "12", "--spp", "4", "--quiet"]
    subprocess.run(command, check=True)
    picture = radiosity.render(cornell, width=16, height=12, samples=4)
    assert np.array_equal(np.asarray(image.open(out)), radiosity.to_srgb(picture))


def test_a_lightmap(solution):
    lightmap = radiosity.bake(solution, resolution=64, final_gather=0)
    assert lightmap.irradiance.shape == (1, 64, 64, 3) and lightmap.standard_error is None
    facets = len(lightmap.uv)
    assert lightmap.uv.shape == (facets, 3, 2) and lightmap.corners.shape == (facets, 3, 3)
    assert np.nanmin(lightmap.uv) >= 0 and np.nanmax(lightmap.uv) <= 1
    # Without a final gather the flux is that of the patches, exactly.
    assert lightmap.flux["map"] == pytest.approx(lightmap.flux["solver"], rel=1e-5)
    # In the middle of a facet the texel has about the light of the patch there.
    a, b, c = (lightmap.corners[:, k] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face_area = np.bincount(lightmap.parent, weights=area, minlength=len(solution.scene))
    assert face_area == pytest.approx(solution.scene.area)
    column, row = np.floor(lightmap.uv.mean(axis=1).T * 64).astype(int)
    texel = lightmap.irradiance[lightmap.page, row, column]
    mean = solution.by_face("irradiance")[lightmap.parent]
    assert np.corrcoef(texel[:, 1], mean[:, 1])[0, 1] > 0.8
    gathered = radiosity.bake(solution, resolution=32, final_gather=16)
    assert 0 < gathered.relative_error < 0.5 and np.isfinite(gathered.standard_error).any()
    assert set(np.unique(gathered.kind)) <= {0, 1, 2, 3}


def test_a_lightmap_is_that_of_the_command_line(cornell, cornell_path, tmp_path):
    command = ["radiosity", "bake", cornell_path, "-o", tmp_path / "lit", "--resolution", "32", "--quality", "draft",
               "--final-gather", "8", "--quiet"]
    subprocess.run(command, check=True)
    report = json.loads((tmp_path / "lit" / "report.json").read_text())
    lightmap = radiosity.bake(cornell, resolution=32, quality="draft", final_gather=8, threads=1)
    flux = lightmap.flux
    assert report["flux"]["solver"] == flux["solver"].tolist() and report["flux"]["map"] == flux["map"].tolist()
    assert report["rms_relative"] == lightmap.relative_error


def test_validation():
    scene = radiosity.Scene(*box(), reflectance=[0.2, 0.8, 0.5, 0.5, 0.5, 0.5], emission=[0, 1, 0, 0, 0, 0])
    told = []
    result = radiosity.validate(scene, patches=100, rays=512, paths=64, particles=200_000, progress=lambda *c: told.append(c))
    assert result and result.valid and result.objections == []
    assert len(result.comparisons) == 3 and result.report["valid"] is True and told


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda s: radiosity.probe(s, [0, 0, 0], [0, 1, 0]), "points"),
        (lambda s: radiosity.probe(s, [[0, 0, 0]], [0, 1]), "normals"),
        (lambda s: radiosity.probe(s, [[0, 0, 0]], [0, 0, 0]), "normals"),
        (lambda s: radiosity.probe(s, [[0, 0, 0]], [0, 1, 0], samples=0), "samples"),
        (lambda s: radiosity.probe(3, [[0, 0, 0]], [0, 1, 0]), "source"),
        (lambda s: radiosity.render(s, width=0), "width"),
        (lambda s: radiosity.render(s, eye=[1, 2]), "eye"),
        (lambda s: radiosity.render(s, fov=-3), "fov"),
        (lambda s: radiosity.render(s, method="magic"), "method"),
        (lambda s: radiosity.render(s, final_gather=2), "final_gather"),
        (lambda s: radiosity.render(3), "source"),
        (lambda s: radiosity.to_srgb([1, 2]), "picture"),
        (lambda s: radiosity.to_srgb([[1, 2, 3]], white=0), "white"),
        (lambda s: radiosity.bake(s, resolution=0, quality="draft"), "resolution"),
        (lambda s: radiosity.bake(s, uv="some", quality="draft"), "uv"),
        (lambda s: radiosity.bake(3), "source"),
        (lambda s: radiosity.validate(s, paths=1), "paths"),
        (lambda s: radiosity.validate(3), "scene"),
    ],
)
def test_wrong_arguments_are_named(cornell, call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call(cornell)
