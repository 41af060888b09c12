"""Long computations: the GIL, Ctrl-C, progress, memory."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import radiosity

LONG = {"patches": 20_000, "rays": 2_000}
"""Minutes of work."""


def test_other_threads_run_meanwhile(cornell):
    """A thread that needs the GIL gets it while a computation runs."""
    turns, seen = 0, []
    stop = threading.Event()

    def work():
        nonlocal turns
        while not stop.is_set():
            turns += 1
            time.sleep(0.001)

    thread = threading.Thread(target=work)
    thread.start()

    def progress(stage, done, total):
        seen.append(turns)

    radiosity.solve(cornell, patches=4000, rays=256, progress=progress)
    stop.set()
    thread.join()
    assert len(seen) >= 2 and seen[-1] > seen[0]


def test_progress_tells_of_stages(cornell):
    calls = []
    radiosity.solve(cornell, patches=4000, rays=256, progress=lambda *call: calls.append(call))
    assert calls and all(0 <= done for _, done, _ in calls)
    assert any(stage.startswith("casting") for stage, _, _ in calls)


def test_what_a_callback_raises_comes_out_as_itself(cornell):
    class Enough(Exception):
        pass

    raised = Enough("told you")

    def progress(stage, done, total):
        raise raised

    with pytest.raises(Enough) as caught:
        radiosity.solve(cornell, progress=progress, **LONG)
    assert caught.value is raised


@pytest.mark.parametrize("call", ["solve", "form_factors", "view_factors", "probe", "render", "bake", "validate"])
def test_control_c_is_heard(cornell, solution, call):
    """A signal ends each function within 0.2 s of its time on the processor; on a busy machine more passes on the clock."""
    work = {
        "solve": lambda **p: radiosity.solve(cornell, **LONG, **p),
        "form_factors": lambda **p: radiosity.form_factors(cornell, **LONG, **p),
        "view_factors": lambda **p: radiosity.view_factors(cornell, error=1e-7, **p),
        "probe": lambda **p: radiosity.probe(cornell, np.full((1000, 3), 200.0), [0, 1, 0], samples=1 << 20, **p),
        "render": lambda **p: radiosity.render(solution, samples=1 << 14, final_gather=64, **p),
        "bake": lambda **p: radiosity.bake(solution, resolution=1024, final_gather=4096, **p),
        "validate": lambda **p: radiosity.validate(cornell, paths=1 << 20, **p),
    }[call]
    sent = []

    def progress(stage, done, total):
        if not sent:
            sent.append(time.monotonic())
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        work(progress=progress)
    assert sent


def test_tqdm_is_taken(cornell):
    tqdm = pytest.importorskip("tqdm")
    bars = []

    class Bar(tqdm.tqdm):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs, disable=None)
            bars.append(self)

    radiosity.solve(cornell, patches=500, rays=16, progress=Bar)
    radiosity.solve(cornell, patches=100, rays=16, progress=True)
    assert len(bars) == 1


def _solve_in_child(path, queue):
    queue.put(radiosity.solve(radiosity.Scene.load(path), patches=100, rays=16).irradiance)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no fork here")
@pytest.mark.filterwarnings("ignore:.*fork")
def test_a_fork_computes_too(cornell, cornell_path):
    expected = radiosity.solve(cornell, patches=100, rays=16).irradiance
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_solve_in_child, args=(cornell_path, queue))
    child.start()
    assert np.array_equal(queue.get(timeout=60), expected)
    child.join()


MEMORY = """
import resource
import numpy as np
import scipy.sparse
import radiosity
vertices = [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]]
faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2]]
factors = radiosity.form_factors(radiosity.Scene(vertices, faces, 0.5, 1), patches=6000, rays=1024)
held = lambda: int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()
# From here on the system measures the peak anew.
open("/proc/self/clear_refs", "w").write("5")
peak = lambda: 1024 * next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
before = held()
F = factors.matrix()
size = F.data.nbytes + F.indices.nbytes + F.indptr.nbytes
print(size, held() - before, peak() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_large_results_are_copied_once():
    """The matrix of form factors takes its own size, and on the way to it that of the stored matrix in single precision."""
    pytest.importorskip("scipy")
    # Freed memory goes back to the system at once.
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}
    run = subprocess.run(
        [sys.executable, "-c", MEMORY], check=True, capture_output=True, text=True, env=environment
    )
    size, grown, peak = map(int, run.stdout.split())
    assert size > 30e6
    # A second copy would make it two sizes.
    assert grown < 1.5 * size
    # Values take 8 of 12 bytes; the values in single precision another 4 for a while, and the pairs they come from 12.
    assert peak < 2.5 * size


def test_arrays_are_kept_and_not_copied_again(solution):
    assert solution.irradiance is solution.irradiance
    assert solution.patches is solution.patches
    assert solution.irradiance.base is not None and solution.irradiance.base.base is None
