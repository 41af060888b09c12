"""The examples of the documents run."""

import importlib.util
import re

import pytest
from conftest import ROOT

PEERS = ("pyviewfactor", "raystrack")
"""Programs that examples compare with, where they are installed."""


@pytest.mark.parametrize("document", ["python/README.md", "docs/guides/python.md"])
def test_examples_run(document, tmp_path, monkeypatch):
    for needed in ("scipy", "pyvista"):
        pytest.importorskip(needed)
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)
    assert len(examples) >= 3
    names = {}
    for example in examples:
        missing = [peer for peer in PEERS if f"import {peer}" in example and not importlib.util.find_spec(peer)]
        if not missing:
            exec(compile(example, document, "exec"), names)
