"""View factors by this package, pyviewfactor and raystrack, side by side: answers, errors and time.

    pip install ./python pyviewfactor==1.1.0 raystrack==2.0.0
    python python/benches/view_factors.py

Seconds are processor time of all threads, the least of three runs, after one that compiles.
"""

import time
import warnings

import numpy as np
import pyviewfactor
import pyvista as pv
import raystrack

import radiosity


def cube():
    """The faces of a unit cube: corners (6, 4, 3), counter-clockwise as seen from inside."""
    squares = []
    for axis in range(3):
        for end in (0, 1):
            square = np.zeros((4, 3))
            square[:, axis] = end
            square[:, (axis + 1) % 3] = (0, 1, 1, 0)
            square[:, (axis + 2) % 3] = (0, 0, 1, 1)
            # Counter-clockwise as seen from the positive axis: inward at the near end.
            squares.append(square if end == 0 else square[::-1])
    return np.array(squares)


def of_radiosity(squares, error=1e-4):
    F, _ = radiosity.view_factors(list(squares), error=error)
    return F


def of_pyviewfactor(squares):
    n = len(squares)
    cells = np.column_stack([np.full(n, 4), np.arange(4 * n).reshape(n, 4)]).ravel()
    mesh = pv.PolyData(squares.reshape(-1, 3), cells)
    # It returns F[i, j] from j to i.
    return np.asarray(pyviewfactor.compute_viewfactor_matrix(mesh, obstacles=[mesh.triangulate()])).T


def of_raystrack(squares, tolerance=1e-4):
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    meshes = {str(k): raystrack.Mesh(square.astype(np.float32), triangles) for k, square in enumerate(squares)}
    accuracy = raystrack.Accuracy(tolerance=tolerance)
    with raystrack.Solver(raystrack.Scene.from_meshes(meshes), device="cpu") as solver:
        result = solver.solve(raystrack.Query.matrix(), raystrack.SolveOptions(accuracy=accuracy))
    F = np.zeros((len(squares), len(squares)))
    fronts = {k: int(c.surface_id) for k, c in enumerate(result.channels) if c.kind == "surface" and c.side == "front"}
    for row, channel, value in zip(result.data.row_indices, result.data.channel_indices, result.data.estimates):
        if channel in fronts:
            F[int(result.sender_ids[row]), fronts[channel]] = value
    return F


PROGRAMS = {"radiosity": of_radiosity, "pyviewfactor": of_pyviewfactor, "raystrack": of_raystrack}


def timed(compute, squares):
    """The matrix, and the least processor time of some runs."""
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        F = compute(squares)
        best = min(best, time.process_time() - start)
    return F, best


def show(title, squares, values):
    """A table of some figures of each program's matrix."""
    print(f"\n{title}")
    for name, compute in PROGRAMS.items():
        F, seconds = timed(compute, squares)
        figures = "  ".join(f"{what} {value(F):.3g}" if "error" in what else f"{what} {value(F):.6f}" for what, value in values.items())
        print(f"{name:14} {figures}  {seconds:.2f} s")


def main():
    warnings.simplefilter("ignore")
    for compute in PROGRAMS.values():
        compute(cube())
    exact = 0.1998248957
    show(
        f"The inside of a cube. Opposite faces: {exact:.6f} exactly",
        cube(),
        {"opposite": lambda F: F[0, 1], "error of sums": lambda F: abs(F.sum(axis=1) - 1).max()},
    )
    floor = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], float)
    half = (floor * [0.5, 1, 1])[::-1] + [0, 0.5, 0]
    show(
        f"Two squares with half a square between them: {exact / 2:.6f} exactly",
        np.array([floor, floor[::-1] + [0, 1, 0], half, half[::-1]]),
        {"F": lambda F: F[0, 1], "error": lambda F: abs(F[0, 1] - exact / 2)},
    )


if __name__ == "__main__":
    main()
