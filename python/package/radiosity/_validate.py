"""Checks of the answer by independent methods."""

from __future__ import annotations

import json
from typing import Any

from . import _arrays
from ._progress import Progress, shown
from ._radiosity import validate as _validate
from ._scene import Scene
from ._solve import casting


class Validation:
    """What checks of a solution found."""

    def __init__(self, report: dict[str, Any]) -> None:
        self.report = report
        """All figures, as the command `radiosity validate --report` writes them."""

    def __repr__(self) -> str:
        return f"<radiosity.Validation: {'passed' if self.valid else '; '.join(self.objections)}>"

    def __bool__(self) -> bool:
        return self.valid

    @property
    def valid(self) -> bool:
        """Whether all checks passed."""
        return bool(self.report["valid"])

    @property
    def objections(self) -> list[str]:
        """The checks that failed, a sentence each."""
        return list(self.report["objections"])

    @property
    def comparisons(self) -> dict[str, dict[str, Any]]:
        """For each pair of methods, how they differ: RMS and mean relative differences, and z-scores."""
        return {entry["what"]: entry for entry in self.report["comparisons"]}


def validate(
    scene: Scene,
    *,
    patches: int | None = None,
    patch_size: float | None = None,
    rays: int | None = None,
    quality: str | None = None,
    linear: bool = True,
    paths: int | None = None,
    particles: int | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = None,
) -> Validation:
    """Check the energy ledger, closure and reciprocity, and compare with path tracing and light tracing patch by patch.

    Parameters
    ----------
    scene : a scene with light.
    patches, patch_size, rays, quality, linear : as in `solve`.
    paths : paths for each patch.
    particles : particles from the lamps.
    seed, threads, progress : as in `solve`.

    >>> box = Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
    ...             reflectance=0.5, emission=[1, 0, 0, 0])
    >>> validate(box, patches=64, rays=256, paths=64, particles=100_000).valid
    True
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene: a radiosity.Scene is wanted, not {type(scene).__name__}")
    options = casting(patches=patches, patch_size=patch_size, rays=rays, quality=quality, linear=linear, seed=seed)
    with shown(progress) as callback:
        report = _validate(
            scene._core,
            options,
            _arrays.count("paths", paths, 16, 1 << 24),
            _arrays.count("particles", particles, 1024, 1 << 40),
            _arrays.threads_of(threads),
            callback,
        )
    return Validation(json.loads(report))
