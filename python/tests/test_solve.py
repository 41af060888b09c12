"""Solutions and form factors."""

import json
import subprocess

import numpy as np
import pytest
from conftest import box

import radiosity


def furnace(reflectance=0.5, emission=1.0):
    """A closed room that reflects and emits alike everywhere: B = pi L / (1 - rho), exactly."""
    return radiosity.Scene(*box((1.0, 2.0, 3.0)), reflectance, emission)


def test_a_furnace_has_one_radiosity():
    solution = radiosity.solve(furnace(0.7, 2.0), patches=100, rays=32)
    # Rows sum to one and the residual is 1e-10 of what is emitted; rounding of the matrix to single precision is 1e-7.
    assert solution.radiosity == pytest.approx(np.full((len(solution), 3), 2 * np.pi / 0.3), rel=1e-6)
    assert solution.irradiance == pytest.approx(np.full((len(solution), 3), 2 * np.pi / 0.3), rel=1e-6)
    ledger = solution.ledger
    assert ledger["emitted"] == pytest.approx([2 * np.pi * 22] * 3)
    assert ledger["absorbed"] == pytest.approx(ledger["emitted"]) and ledger["escaped"] == pytest.approx([0] * 3, abs=1e-12)


def test_arrays_fit_each_other(solution):
    p = len(solution)
    patches = solution.patches
    for array in (solution.irradiance, solution.radiosity, solution.standard_error, patches.reflectance, patches.emission):
        assert array.shape == (p, 3) and array.dtype == np.float64
    # B = Be + rho E, patch by patch.
    balance = patches.emission + patches.reflectance * solution.irradiance
    assert solution.radiosity == pytest.approx(balance, rel=1e-6, abs=1e-9)
    a, b, c = (patches.vertices[patches.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    assert patches.area == pytest.approx(0.5 * np.linalg.norm(cross, axis=1))
    assert patches.normal == pytest.approx(cross / np.linalg.norm(cross, axis=1, keepdims=True))
    front_area = np.bincount(patches.parent[patches.front], weights=patches.area[patches.front])
    assert front_area == pytest.approx(solution.scene.area)
    flux = (patches.area[:, None] * (1 - patches.reflectance) * solution.irradiance).sum(axis=0)
    assert flux == pytest.approx(solution.ledger["absorbed"], rel=1e-9)
    assert abs(solution.ledger["imbalance"]) < 1e-9


def test_means_by_face(solution):
    mean = solution.by_face("irradiance")
    patches, face = solution.patches, 3
    chosen = patches.front & (patches.parent == face)
    expected = np.average(solution.irradiance[chosen], axis=0, weights=patches.area[chosen])
    assert mean.shape == (len(solution.scene), 3) and mean[face] == pytest.approx(expected)
    assert solution.by_face(patches.front.astype(float))[:, 0] == pytest.approx(np.ones(len(solution.scene)))
    with pytest.raises(ValueError, match="^values"):
        solution.by_face(np.zeros(3))


def test_results_are_those_of_the_command_line(cornell, cornell_path, tmp_path):
    """To the byte, for the same seed, and for any number of threads."""
    mesh, report = tmp_path / "cli.ply", tmp_path / "cli.json"
    for options, arguments in [
        (["--patches", "300", "--rays", "48", "--seed", "7"], {"patches": 300, "rays": 48, "seed": 7}),
        (["--error", "6"], {"error": 0.06}),
        (["--patches", "300", "--rays", "48", "--constant-light"], {"patches": 300, "rays": 48, "linear": False}),
    ]:
        command = ["radiosity", "solve", cornell_path, "-o", mesh, "--report", report, "--quiet", *options]
        subprocess.run(command, check=True)
        solution = radiosity.solve(cornell, threads=1, **arguments)
        solution.save(tmp_path / "python.ply")
        assert mesh.read_bytes() == (tmp_path / "python.ply").read_bytes()
        told = json.loads(report.read_text())
        assert {k: v for k, v in told["energy"].items() if k in solution.ledger} == solution.ledger
        assert told["error"]["rms_relative"] == solution.errors["sampling"]
        assert told["error"]["discretisation_relative"] == solution.errors["discretisation"]
        assert told["error"]["total_relative"] == solution.errors["total"]
        assert told["error"]["bias_relative"] == solution.errors["bias"]


def test_linear_light_has_slopes_that_keep_the_mean(cornell):
    constant = radiosity.solve(cornell, patches=300, rays=64, linear=False)
    linear = radiosity.solve(cornell, patches=300, rays=64)
    assert constant.slopes is None and linear.slopes.shape == (len(linear), 3, 2)
    # At the corners of a patch the two functions are (1, 1), (-1, 1) and (0, -2): they sum to zero, and light is nowhere negative.
    at = [linear.irradiance + linear.slopes @ np.array(corner) for corner in ([1.0, 1], [-1, 1], [0, -2])]
    assert np.mean(at, axis=0) == pytest.approx(linear.irradiance) and np.min(at) > -1e-9 * linear.irradiance.max()
    assert abs(linear.ledger["imbalance"]) < 1e-9
    again = radiosity.form_factors(cornell, patches=300, rays=64).solve()
    assert np.array_equal(again.slopes, linear.slopes) and np.array_equal(again.irradiance, linear.irradiance)


def test_an_error_is_reached(cornell):
    solution = radiosity.solve(cornell, error=0.05)
    assert 0 < solution.errors["sampling"] <= 0.05 and solution.errors["discretisation"] <= 0.05
    assert solution.rounds[-1]["error"] == solution.errors["sampling"]


def test_form_factors_serve_other_lightings(cornell):
    factors = radiosity.form_factors(cornell, patches=400, rays=64, seed=3)
    same = factors.solve()
    assert np.array_equal(same.irradiance, radiosity.solve(cornell, patches=400, rays=64, seed=3).irradiance)
    double = factors.solve(emission={"light": 2 * np.array(cornell.materials["light"][1])})
    assert double.irradiance == pytest.approx(2 * same.irradiance, rel=1e-6)
    # Floor and lamp together are floor plus lamp. Slopes are cut where light would be negative, so that this holds for constant light.
    same = factors.solve(linear=False)
    names = list(cornell.materials)
    other = next(name for name in names if name != "light")
    dark = {name: 0 for name in names}
    alone = factors.solve(emission=dark | {other: [1, 0, 2]}, linear=False)
    both = factors.solve(emission={other: [1, 0, 2]}, linear=False)
    assert both.irradiance == pytest.approx(same.irradiance + alone.irradiance, rel=1e-6, abs=1e-9)
    black = factors.solve(reflectance=0)
    assert black.radiosity == pytest.approx(black.patches.emission)
    with pytest.raises(ValueError, match="^reflectance"):
        factors.solve(reflectance=2)


def test_the_matrix_is_reciprocal_and_closed(cornell):
    pytest.importorskip("scipy")
    factors = radiosity.form_factors(cornell, patches=200, rays=32)
    F = factors.matrix()
    p = len(factors)
    assert F.shape == (p, p) and F.has_sorted_indices
    assert F.sum(axis=1).A1 + factors.escaped == pytest.approx(np.ones(p), abs=1e-9)
    exchange = F.multiply(factors.area[:, None]).tocsr()
    assert abs(exchange - exchange.T).max() < 1e-12 * exchange.max()


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"error": 0}, "error"),
        ({"error": 1.5}, "error"),
        ({"error": 0.1, "rays": 3}, "error"),
        ({"rays": 0}, "rays"),
        ({"rays": 2.5}, "rays"),
        ({"patches": -1}, "patches"),
        ({"patches": 3, "patch_size": 1.0}, "patches"),
        ({"patch_size": "big"}, "patch_size"),
        ({"quality": "best"}, "quality"),
        ({"seed": -1}, "seed"),
        ({"threads": 0}, "threads"),
        ({"solver": "magic"}, "solver"),
        ({"estimator": "magic"}, "estimator"),
        ({"tolerance": 2}, "tolerance"),
        ({"progress": 3}, "progress"),
    ],
)
def test_wrong_arguments_are_named(cornell, arguments, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        radiosity.solve(cornell, **arguments)


def test_what_does_not_fit_is_refused_before_the_work(cornell):
    with pytest.raises(MemoryError, match="GiB"):
        radiosity.solve(cornell, patches=50_000_000, rays=100_000)


def test_every_solver_gives_the_same_light(cornell):
    first = radiosity.solve(cornell, patches=60, rays=32).irradiance
    for solver in ("gauss-seidel", "jacobi", "southwell", "direct"):
        other = radiosity.solve(cornell, patches=60, rays=32, solver=solver)
        assert other.solver["name"] == solver
        assert other.irradiance == pytest.approx(first, rel=1e-5)
