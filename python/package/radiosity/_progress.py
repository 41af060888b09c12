"""How progress is shown."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Callback = Callable[[str, int, int], object]
"""Called with the name of the stage, the steps done, and the steps of the stage (0 where their number is unknown)."""

Progress = bool | None | Callback | type[Any]


class _Bar:
    """A bar of tqdm, which starts again with every stage."""

    def __init__(self, kind: Any) -> None:
        self.bar = kind(total=None, unit="step", unit_scale=True, leave=False)
        self.stage = ""

    def __call__(self, stage: str, done: int, total: int) -> None:
        if (stage, total or None) != (self.stage, self.bar.total):
            if stage != self.stage:
                self.bar.reset()
                self.bar.set_description(stage)
            self.stage = stage
            self.bar.total = total or None
        self.bar.update(max(done - self.bar.n, 0))

    def close(self) -> None:
        self.bar.close()


class _Line:
    """A line on a terminal, for those who have no tqdm."""

    def __init__(self) -> None:
        self.shown = ""

    def __call__(self, stage: str, done: int, total: int) -> None:
        line = f"{stage} {100 * done // total} %" if total else stage
        if line != self.shown:
            sys.stderr.write("\r\x1b[K" + line)
            sys.stderr.flush()
            self.shown = line

    def close(self) -> None:
        sys.stderr.write("\r\x1b[K")


@contextmanager
def shown(progress: Progress) -> Iterator[Callback | None]:
    """The callback for what a user has given as `progress`."""
    display: _Bar | _Line | None = None
    if progress is None or progress is False:
        yield None
        return
    if progress is True:
        if not sys.stderr.isatty():
            yield None
            return
        try:
            from tqdm import tqdm
        except ImportError:
            display = _Line()
        else:
            display = _Bar(tqdm)
    elif isinstance(progress, type) and hasattr(progress, "set_description"):
        display = _Bar(progress)
    elif callable(progress):
        yield progress
        return
    else:
        raise ValueError(f"progress: True, tqdm, or a function of (stage, done, total) is wanted, not {progress!r}")
    try:
        yield display
    finally:
        display.close()
