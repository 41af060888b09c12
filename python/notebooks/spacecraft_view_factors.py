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
# # View factors of a spacecraft's box, with an obstruction
#
# A thermal model wants the view factors between the panels of an equipment bay, with units standing between them. A view factor
# F[i, j] is the share of what leaves panel i that arrives at panel j.

# %%
import numpy as np

import radiosity

width, depth, height = 1.2, 0.8, 1.0  # metres


def box(low, high, inward):
    """Six faces: floor, ceiling, and walls at -x, +x, -z, +z. Their fronts look inward or outward."""
    (x, y, z), (X, Y, Z) = low, high
    vertices = np.array([[x, y, z], [X, y, z], [X, y, Z], [x, y, Z], [x, Y, z], [X, Y, z], [X, Y, Z], [x, Y, Z]])
    faces = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2]])
    return vertices, faces if inward else faces[:, ::-1]


# %% [markdown]
# ## The empty bay
#
# Between parallel and between perpendicular rectangles there are closed forms (Howell, *A Catalog of Radiation Heat Transfer
# Configuration Factors*, C-11 and C-14).


# %%
def parallel(a, b, c):
    """From a rectangle a by b to an equal one at distance c."""
    x, y = a / c, b / c
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    total = np.log(p * q / np.sqrt(1 + x * x + y * y))
    total += x * q * np.arctan(x / q) + y * p * np.arctan(y / p) - x * np.arctan(x) - y * np.arctan(y)
    return 2 * total / (np.pi * x * y)


def perpendicular(common, own, other):
    """From a rectangle `common` by `own` to one `common` by `other` that adjoins it at a right angle."""
    h, w = other / common, own / common
    r2 = h * h + w * w
    total = w * np.arctan(1 / w) + h * np.arctan(1 / h) - np.sqrt(r2) * np.arctan(1 / np.sqrt(r2))
    a = (1 + w * w) * (1 + h * h) / (1 + r2)
    b = w * w * (1 + r2) / ((1 + w * w) * r2)
    c = h * h * (1 + r2) / ((1 + h * h) * r2)
    total += 0.25 * np.log(a * b ** (w * w) * c ** (h * h))
    return total / (np.pi * w)


vertices, faces = box((0, 0, 0), (width, height, depth), inward=True)
empty = radiosity.view_factors(vertices, faces)
for name, found, exact in [
    ("floor to ceiling", empty[0, 1], parallel(width, depth, height)),
    ("floor to wall at -x", empty[0, 2], perpendicular(depth, width, height)),
    ("floor to wall at -z", empty[0, 4], perpendicular(width, depth, height)),
]:
    print(f"{name:20} {found:.7f}, exact {exact:.7f}")
    assert abs(found - exact) < 2e-5 * exact

# %% [markdown]
# ## A unit in the middle
#
# A box hangs in the bay. Its faces are surfaces too, and it hides panels from each other. It is convex, so that what leaves it
# arrives at the panels only. By reciprocity the sum of A_i F[i, unit] over the panels is then the area of the unit.

# %%
unit_vertices, unit_faces = box((0.4, 0.3, 0.25), (0.8, 0.7, 0.55), inward=False)
both = np.vstack([vertices, unit_vertices])
obstructed = radiosity.view_factors(both, np.vstack([faces, unit_faces + len(vertices)]), error=1e-4)
F, standard_error = obstructed
print(obstructed, "with", obstructed.rays, "rays")

panels, unit = slice(0, 6), slice(6, 12)
assert np.allclose(F.sum(axis=1), 1, atol=1e-9)
assert np.allclose(F[unit, panels].sum(axis=1), 1, atol=1e-9) and not F[unit, unit].any()
exchange = obstructed.area[:, None] * F
assert np.allclose(exchange, exchange.T, atol=1e-12)
unit_area = obstructed.area[unit].sum()
print(f"sum of A_i F_i,unit over the panels {exchange[panels, unit].sum():.9f}, area of the unit {unit_area:.9f}")
assert abs(exchange[panels, unit].sum() / unit_area - 1) < 1e-9

# %% [markdown]
# ## A closed form with an obstruction
#
# Two equal, directly opposed squares, and between them, halfway, a square of the same size. It hides all of one from the other,
# and each of them sees one of its two sides as an opposed square at half the distance.

# %%
square = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], dtype=float)
floor, roof, plate = square, square[::-1] + [0, 1, 0], square[::-1] + [0, 0.5, 0]
hidden = radiosity.view_factors([floor, roof, plate, plate[::-1]])
print("floor to roof", hidden[0, 1], "; to the plate", hidden[0, 2], hidden[1, 3], "exact", parallel(1, 1, 0.5))
assert hidden[0, 1] < 1e-6
assert np.allclose([hidden[0, 2], hidden[1, 3]], parallel(1, 1, 0.5), rtol=0, atol=2e-5)

# %% [markdown]
# A plate may also be an obstacle, which blocks and has no row of its own. Half a plate, over x < 1/2, hides exactly half: by
# symmetry, half of the lines between floor and roof pass the middle plane at x < 1/2.

# %%
half = plate * [0.5, 1, 1]
part = radiosity.view_factors([floor, roof], obstacles=[half], error=1e-5)
print("with half a plate", part[0, 1], "+-", part.standard_error[0, 1], "exact", parallel(1, 1, 1) / 2)
assert abs(part[0, 1] - parallel(1, 1, 1) / 2) < 4 * part.standard_error[0, 1] + 1e-6

# %% [markdown]
# ## Heat
#
# Grey panels of emissivity 0.85 at 293 K, and a unit that dissipates 40 W. B = eps sigma T^4 + (1 - eps) F B, and each face of
# the unit gives off A (B - F B).

# %%
sigma, emissivity = 5.670374419e-8, 0.85
n = len(F)
area = obstructed.area


def heat(temperature):
    radiosity_ = np.linalg.solve(np.eye(n) - (1 - emissivity) * F, emissivity * sigma * temperature**4)
    return area * (radiosity_ - F @ radiosity_)


low, high = 293.0, 600.0
while high - low > 1e-9:
    middle = (low + high) / 2
    temperature = np.where(np.arange(n) < 6, 293.0, middle)
    low, high = (middle, high) if heat(temperature)[unit].sum() < 40 else (low, middle)
q = heat(temperature)
print(f"the unit is at {middle:.2f} K; heat that arrives at the panels, W: {np.round(-q[panels], 2)}")
assert abs(q.sum()) < 1e-9 * 40
