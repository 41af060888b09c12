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
# # A street canyon: sky view factors, and the light of a day
#
# A long street between two rows of buildings. The sky view factor of a surface is the share of what leaves it that goes to the
# sky. It decides how much diffuse light arrives from an even sky, and how fast the surface cools at night.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import radiosity

width, height, length, strips = 12.0, 18.0, 1200.0, 8  # metres; long, so that its ends do not matter


def panel(a, b):
    """A strip of the street along z, from the line at a to the line at b, both (x, y). Its front is on the left of a to b."""
    (x, y), (X, Y), z = a, b, length / 2
    return [[x, y, -z], [x, y, z], [X, Y, z], [X, Y, -z]]


edges = np.linspace(0, 1, strips + 1)
street = [panel((width * s, 0), (width * t, 0)) for s, t in zip(edges, edges[1:])]
right = [panel((width, height * s), (width, height * t)) for s, t in zip(edges, edges[1:])]
left = [panel((0, height * t), (0, height * s)) for s, t in zip(edges, edges[1:])]
result = radiosity.view_factors(street + right + left, up=[0, 1, 0])
sky = result.sky.value
print(result)

# %% [markdown]
# In an endless canyon the crossed-strings rule (Hottel) gives the view factor from a strip to the opening above: half of the sum
# of the diagonals less the sum of the sides, over the width of the strip.


# %%
def crossed_strings(a, b, c, d):
    """From segment a-b to segment c-d, with a opposite d."""

    def gap(p, q):
        return np.hypot(p[0] - q[0], p[1] - q[1])

    return (gap(a, c) + gap(b, d) - gap(a, d) - gap(b, c)) / (2 * gap(a, b))


roof = ((width, height), (0, height))
exact = [crossed_strings((width * s, 0), (width * t, 0), *roof) for s, t in zip(edges, edges[1:])]
print("street", np.round(sky[:strips], 4), "\nexact ", np.round(exact, 4))
# The ends of the street, which are open here, add about height / length.
assert np.allclose(sky[:strips], exact, atol=0.01)
whole = np.average(sky[:strips])
print(f"the whole street sees {whole:.4f} of the sky; sqrt(1 + h^2) - h with h = H / W gives "
      f"{np.hypot(1, height / width) - height / width:.4f}")

# %% [markdown]
# ## A clear day in June at 48 degrees north
#
# The street runs from east to west, and south is toward -x. So the wall at x = W looks south. Which part of each strip the sun
# reaches follows from its position. Diffuse light comes from the sky by the sky view factors, and from other surfaces by the
# view factors between them. All surfaces reflect 30 %.

# %%
F = result.F
rho = np.full(len(F), 0.3)
hours = np.linspace(4, 20, 65)
latitude, declination = np.radians(48), np.radians(23.4)
angle = np.radians(15 * (hours - 12))
sine = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(angle)
# Components of the direction to the sun: upward, and toward the south, which is -x here.
up = np.maximum(sine, 0)
south = np.cos(declination) * np.cos(angle) * np.sin(latitude) - np.sin(declination) * np.cos(latitude)
beam_normal = np.where(up > 0, 1361 * 0.7 ** (1 / np.maximum(up, 0.05)) ** 0.678, 0)
diffuse = 0.12 * beam_normal * up + 20 * (up > 0)


def lit_share(a, b, u, s):
    """The share of a strip that the sun reaches, sampled at 32 points of the cross section."""
    t = (np.arange(32) + 0.5) / 32
    x, y = a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t
    if u <= 0:
        return 0.0
    # Where the ray toward the sun is at the height of the roofs: between them, or a wall is in its way.
    at_top = x - s * (height - y) / u
    return float(np.mean((at_top >= -1e-9) & (at_top <= width + 1e-9)))


def lines(surface):
    if surface == "street":
        return [((width * s, 0), (width * t, 0)) for s, t in zip(edges, edges[1:])]
    if surface == "right":
        return [((width, height * s), (width, height * t)) for s, t in zip(edges, edges[1:])]
    return [((0, height * t), (0, height * s)) for s, t in zip(edges, edges[1:])]


arriving = []
for u, s, beam, even in zip(up, south, beam_normal, diffuse):
    direct = []
    for surface, cosine in (("street", u), ("right", s), ("left", -s)):
        shares = [lit_share(a, b, u, s) for a, b in lines(surface)]
        direct += [beam * max(cosine, 0.0) * share for share in shares]
    source = np.array(direct) + even * sky
    # Irradiance E = source + F (rho E).
    arriving.append(np.linalg.solve(np.eye(len(F)) - F * rho, source))
arriving = np.array(arriving)

# %%
figure, (first, second) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
first.plot((edges[1:] + edges[:-1]) / 2 * width, sky[:strips], "o-", label="computed")
first.plot((edges[1:] + edges[:-1]) / 2 * width, exact, "k:", label="crossed strings")
first.set(xlabel="across the street, m", ylabel="sky view factor", ylim=(0, None))
first.legend()
for name, part in (("street", slice(0, strips)), ("wall that looks south", slice(strips, 2 * strips)),
                   ("wall that looks north", slice(2 * strips, None))):
    second.plot(hours, arriving[:, part].mean(axis=1), label=name)
second.set(xlabel="solar time, h", ylabel="mean irradiance, W/m2")
second.legend()
figure.savefig(Path(os.environ.get("NOTEBOOK_OUTPUT", ".")) / "street-canyon.png", dpi=150)

# %% [markdown]
# The energy balances at every hour: what the surfaces absorb and what escapes is what came from the sun and the sky.

# %%
area, escaped = result.area, result.escaped
for row, u, s, beam, even in zip(arriving, up, south, beam_normal, diffuse):
    source = row - F @ (rho * row)
    entered = (area * source).sum()
    left_again = (area * rho * row * escaped).sum()
    absorbed = (area * (1 - rho) * row).sum()
    assert abs(entered - left_again - absorbed) <= 1e-9 * max(entered, 1)
steps = np.diff(hours)[:, None]
total = ((arriving[1:] + arriving[:-1]) / 2 * steps).sum(axis=0) / 1000
print(f"daily totals, kWh/m2: street {total[:strips].mean():.2f}, wall that looks south {total[strips:2 * strips].mean():.2f}, "
      f"wall that looks north {total[2 * strips:].mean():.2f}")
