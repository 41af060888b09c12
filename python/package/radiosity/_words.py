"""Options of scenes as words of the command line, which reads them alike for both."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from typing import Any

import numpy.typing as npt

from . import _arrays

Path = str | os.PathLike[str]
Sky = Path | tuple[str, float] | tuple[str, float, float]

_NAMES = {"emit": "emission", "light": "luminaires"}
"""Arguments that have another name than the option."""


@contextmanager
def arguments_named() -> Iterator[None]:
    """Errors that name options name arguments instead."""
    try:
        yield
    except ValueError as error:
        option = r"--([a-z][a-z-]*)"
        text = re.sub(option, lambda found: _NAMES.get(found[1], found[1].replace("-", "_")), str(error))
        raise ValueError(text) from None


def _numbers(name: str, values: npt.ArrayLike, counts: tuple[int, ...]) -> str:
    array = _arrays.numbers(name, values)
    if array.ndim != 1 or len(array) not in counts:
        wanted = " or ".join(map(str, counts))
        raise ValueError(f"{name}: {wanted} numbers are wanted, not shape {array.shape}")
    return ",".join(map(repr, array.tolist()))


def _texts(name: str, values: Sequence[str]) -> list[str]:
    if isinstance(values, str):
        raise ValueError(f"{name}: a list of names is wanted, not a name")
    return [str(value) for value in values]


def of_lights(
    *,
    sun: Sequence[float] | None,
    sky: Sky | None,
    sky_rotation: float | None,
    place: Sequence[float] | None,
    at: datetime | str | None,
    luminaires: Sequence[tuple[Path, Sequence[float]]],
    lights: Path | None,
    up: str | None,
) -> list[str]:
    """Words for lights that are no surfaces."""
    words = []
    if sun is not None:
        words.append("--sun=" + _numbers("sun", sun, (2, 3)))
    if isinstance(sky, tuple):
        if len(sky) < 2 or not isinstance(sky[0], str):
            raise ValueError(f"sky: a kind and its numbers are wanted, not {sky!r}")
        words.append(f"--sky={sky[0]}:" + _numbers("sky", sky[1:], (1, 2)))
    elif sky is not None:
        words.append(f"--sky={os.fspath(sky)}")
    if sky_rotation is not None:
        words.append("--sky-rotation=" + _numbers("sky_rotation", [sky_rotation], (1,)))
    if place is not None:
        words.append("--place=" + _numbers("place", place, (2,)))
    if at is not None:
        words.append("--at=" + (at.isoformat(timespec="seconds") if isinstance(at, datetime) else str(at)))
    for luminaire in luminaires:
        if isinstance(luminaire, str) or len(luminaire) != 2:
            raise ValueError(f"luminaires: pairs of a file and a position are wanted, not {luminaire!r}")
        words.append(f"--light={os.fspath(luminaire[0])}@" + _numbers("luminaires", luminaire[1], (3,)))
    if lights is not None:
        words.append(f"--lights={os.fspath(lights)}")
    if up is not None:
        if up not in ("y", "z"):
            raise ValueError(f'up: "y" or "z" is wanted, not {up!r}')
        words.append(f"--up={up}")
    return words


def _by_material(option: str, argument: str, values: Any) -> list[str]:
    if values is None:
        return []
    if not isinstance(values, Mapping):
        return [f"--{option}=" + ",".join(map(repr, _arrays.colour(argument, values)))]
    colours = {str(name): _arrays.colour(f"{argument}[{name!r}]", value) for name, value in values.items()}
    return [f"--{option}=" + ",".join(map(repr, colour)) + f"@{name}" for name, colour in colours.items()]


def of_scene(
    path: Path,
    lights: list[str],
    *,
    reflectance: Any,
    emission: Any,
    ignore: Sequence[str],
    emitters: Sequence[str] | None,
    models: Mapping[str, str] | None,
    specular: str,
    unlit_emits: bool,
    photometric: bool,
    luminous_efficacy: float | None,
) -> list[str]:
    """Words for a scene."""
    words = lights + _by_material("reflectance", "reflectance", reflectance)
    words += _by_material("emit", "emission", emission)
    words += [f"--ignore={name}" for name in _texts("ignore", ignore)]
    if emitters is not None:
        names = _texts("emitters", emitters)
        if not names or any("," in name for name in names):
            raise ValueError("emitters: names without commas are wanted, one at least")
        words.append("--emitters=" + ",".join(names))
    words += [f"--model={name}={model}" for name, model in (models or {}).items()]
    if specular not in ("drop", "diffuse"):
        raise ValueError(f'specular: "drop" or "diffuse" is wanted, not {specular!r}')
    words.append(f"--specular={specular}")
    if unlit_emits:
        words.append("--unlit-emits")
    if photometric:
        words.append("--photometric")
    if luminous_efficacy is not None:
        words.append("--luminous-efficacy=" + _numbers("luminous_efficacy", [luminous_efficacy], (1,)))
    return [*words, "--", os.fspath(path)]
