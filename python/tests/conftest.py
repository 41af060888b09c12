"""What tests share."""

from pathlib import Path

import numpy as np
import pytest

import radiosity

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def readable_arrays():
    """Doctests and messages print arrays alike in every version of numpy."""
    with np.printoptions(legacy="1.25"):
        yield


@pytest.fixture(scope="session")
def cornell_path() -> Path:
    return ROOT / "meshes" / "cornell-box.obj"


@pytest.fixture(scope="session")
def cornell(cornell_path) -> radiosity.Scene:
    return radiosity.Scene.load(cornell_path)


@pytest.fixture(scope="session")
def solution(cornell) -> radiosity.Solution:
    return radiosity.solve(cornell, patches=400, rays=64, seed=3)


def box(size=(1.0, 1.0, 1.0)):
    """The six faces of a room, seen from inside: floor, ceiling, and four walls."""
    x, y, z = size
    vertices = [[0, 0, 0], [x, 0, 0], [x, 0, z], [0, 0, z], [0, y, 0], [x, y, 0], [x, y, z], [0, y, z]]
    faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2]]
    return np.array(vertices, dtype=float), np.array(faces)
