# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # The error of a Cornell box, over the number of rays
#
# Every solution comes with standard errors. Here they are compared with the true error: the difference from a solution with many
# more rays on the same patches.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import radiosity

here = Path(__file__).parent if "__file__" in globals() else Path()
box = radiosity.Scene.load(here / "../../meshes/cornell-box.obj")
print(box)

# %% [markdown]
# The reference has 32 times as many rays as the best of the solutions, and another seed.

# %%
patches = 500
reference = radiosity.solve(box, patches=patches, rays=16_384, seed=99)
fronts = reference.patches.front
area = reference.patches.area[fronts]
mean = np.average(reference.irradiance[fronts].mean(axis=1), weights=area)


def rms(values):
    """Root mean square over area and colours, relative to the mean irradiance."""
    return np.sqrt(np.average((values[: fronts.sum()] ** 2).mean(axis=1), weights=area)) / mean


# %%
rays = 2 ** np.arange(5, 10)
true, estimated, covered = [], [], []
for n in rays:
    solution = radiosity.solve(box, patches=patches, rays=int(n), seed=1)
    k = fronts.sum()
    difference = solution.irradiance[:k] - reference.irradiance[:k]
    true.append(rms(difference))
    estimated.append(rms(solution.standard_error))
    covered.append(np.mean(np.abs(difference) <= 2.131 * solution.standard_error[:k]))
    print(f"{n:5d} rays: true error {100 * true[-1]:.2f} %, estimated {100 * estimated[-1]:.2f} %, "
          f"{100 * covered[-1]:.1f} % of the values in their 95 % intervals")

# %%
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
axes.loglog(rays, 100 * np.array(true), "o-", label="true")
axes.loglog(rays, 100 * np.array(estimated), "s--", label="estimated")
axes.loglog(rays, 100 * true[0] * np.sqrt(rays[0] / rays), ":", color="grey", label="independent rays")
axes.set(xlabel="rays a patch", ylabel="RMS error of irradiance, %", title=f"Cornell box, {len(reference)} patches")
axes.legend()
figure.savefig(Path(os.environ.get("NOTEBOOK_OUTPUT", ".")) / "cornell-box-error.png", dpi=150)

# %% [markdown]
# The estimate is near the truth, and the error falls at least as fast as that of independent rays.

# %%
assert all(0.6 < e / t < 1.6 for e, t in zip(estimated, true, strict=True))
assert true[-1] < 1.2 * true[0] * np.sqrt(rays[0] / rays[-1])
assert min(covered) > 0.9
