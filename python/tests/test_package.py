"""What the package installs."""

import doctest
import importlib
import pkgutil
import subprocess
import sys

import numpy as np
import pytest

import radiosity


def test_the_program_is_on_the_path(cornell_path, tmp_path):
    for command in (["radiosity"], [sys.executable, "-m", "radiosity"]):
        told = subprocess.run([*command, "--version"], check=True, capture_output=True, text=True)
        assert told.stdout == f"radiosity {radiosity.__version__}\n"
        wrong = subprocess.run([*command, "solve", tmp_path / "none.obj"], capture_output=True, text=True)
        assert wrong.returncode == 2 and "none.obj" in wrong.stderr and "Traceback" not in wrong.stderr


@pytest.mark.parametrize("name", [m.name for m in pkgutil.iter_modules(radiosity.__path__) if m.name != "__main__"])
def test_examples_in_docstrings(name):
    module = importlib.import_module(f"radiosity.{name}")
    with np.printoptions(legacy="1.25"):
        assert doctest.testmod(module).failed == 0


def test_the_example_of_the_package():
    result = doctest.testmod(radiosity)
    assert result.failed == 0 and result.attempted > 0


def test_everything_public_is_documented():
    for name in radiosity.__all__:
        thing = getattr(radiosity, name)
        assert name == "__version__" or thing.__doc__, name
        if isinstance(thing, type):
            for attribute in vars(thing):
                value = getattr(thing, attribute)
                assert attribute.startswith("_") or callable(value) or getattr(value, "__doc__", None), f"{name}.{attribute}"
