"""How light spreads by diffuse reflection, and view factors, with error bars.

>>> import radiosity
>>> room = radiosity.Scene(
...     vertices=[[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]],
...     faces=[[0, 3, 2, 1], [4, 5, 6, 7]],  # a floor that faces up, a lamp that faces down
...     reflectance=0.5,
...     emission=[0.0, 1.0],  # radiance, W/(m2 sr)
... )
>>> solution = radiosity.solve(room, patches=200, rays=256)
>>> floor = solution.by_face("irradiance")[0, 0]  # W/m2
>>> bool(abs(floor / (3.14159265 * 0.199825) - 1) < 0.02)  # two unit squares at a distance of one
True

Lengths are in any unit. Radiance is in W/(m2 sr), irradiance and radiosity are in W/m2, power is in W if lengths are in metres.
Every function computes outside of the GIL, stops on Ctrl-C, and gives the same bytes for the same seed, for any number of threads.
"""

from ._bake import Lightmap, bake
from ._probe import Probes, probe
from ._radiosity import __version__
from ._render import render, to_srgb
from ._scene import Scene
from ._solve import FormFactors, Patches, Solution, form_factors, solve
from ._validate import Validation, validate
from ._view_factors import ViewFactors, view_factors

__all__ = [
    "FormFactors",
    "Lightmap",
    "Patches",
    "Probes",
    "Scene",
    "Solution",
    "Validation",
    "ViewFactors",
    "__version__",
    "bake",
    "form_factors",
    "probe",
    "render",
    "solve",
    "to_srgb",
    "validate",
    "view_factors",
]
