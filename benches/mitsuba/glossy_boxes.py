"""Mean radiance of the quarters of a picture of the Cornell box with glossy blocks, by Mitsuba 3's scalar path integrator.

    python3 -m venv /tmp/mitsuba && /tmp/mitsuba/bin/pip install mitsuba numpy
    /tmp/mitsuba/bin/python benches/mitsuba/glossy_boxes.py [SAMPLES] [RUNS] [PROGRAM]

The means and their standard errors are kept in `src/monte_carlo/tests/mitsuba.rs`, where ours are compared with them.

With PROGRAM, `radiosity render` takes as many samples on one thread. Printed is its processor time, without that of starting, times
the variance of its runs, over the same product of Mitsuba: below 1 where the program needs less time for the same variance. Variances of rare bright paths need
hundreds of runs.
"""

import pathlib
import resource
import subprocess
import sys
import tempfile
import time

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")

MESH = pathlib.Path(__file__).parents[2] / "meshes" / "cornell-box.obj"
KD = {"white": [0.725, 0.71, 0.68], "red": [0.63, 0.065, 0.05], "green": [0.14, 0.45, 0.091], "light": [0.78] * 3}


def diffuse(name):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": KD[name]}}


def rough(distribution, alpha, ks):
    return {"type": "roughconductor", "material": "none", "distribution": distribution, "alpha": alpha,
            "specular_reflectance": {"type": "rgb", "value": [ks] * 3}}


def mirror(ks):
    return {"type": "conductor", "material": "none", "specular_reflectance": {"type": "rgb", "value": [ks] * 3}}


SCENES = {
    "mirror and GGX": {"tall block": mirror(0.9), "short block": rough("ggx", 0.2, 0.8)},
    "Beckmann and GGX": {"tall block": rough("beckmann", 0.3, 0.7), "short block": rough("ggx", 0.5, 0.9)},
}


def objects():
    """Triangles of each object of the mesh, with its material."""
    vertices, found, name, material = [], {}, None, None
    for line in MESH.read_text().splitlines():
        words = line.split()
        if not words or words[0] == "#":
            continue
        if words[0] == "v":
            vertices.append([float(x) for x in words[1:]])
        elif words[0] == "o":
            name = line[2:]
        elif words[0] == "usemtl":
            material = words[1]
        elif words[0] == "f":
            corners = [vertices[int(w) - 1] for w in words[1:]]
            triangles = found.setdefault(name, (material, []))[1]
            triangles += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return found


def mesh(triangles, bsdf, radiance=None):
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    if radiance:
        props["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": radiance}})
    made = mi.Mesh("mesh", 3 * len(triangles), len(triangles), props=props)
    params = mi.traverse(made)
    params["vertex_positions"] = np.ravel(triangles).astype(np.float32).tolist()
    params["faces"] = list(range(3 * len(triangles)))
    params.update()
    return made


def scene(blocks):
    content = {"type": "scene", "integrator": {"type": "path", "max_depth": -1, "rr_depth": 5}}
    for k, (name, (material, triangles)) in enumerate(objects().items()):
        radiance = [17.0, 12.0, 4.0] if material == "light" else None
        content[f"shape{k}"] = mesh(triangles, blocks.get(name, diffuse(material)), radiance)
    content["sensor"] = {
        "type": "perspective", "fov": 39.3, "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at([278, 273, -800], [278, 273, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"},
                 "component_format": "float32"},
        "sampler": {"type": "independent"},
    }
    return mi.load_dict(content)


# The models of SCENES as options of `radiosity render`. Its facets are correlated by height, which Mitsuba's are not: means differ by
# up to a percent, costs do not.
MODELS = {
    "mirror and GGX": ["tall=mirror:0.9", "short=ggx:0.8,0.2"],
    "Beckmann and GGX": ["tall=beckmann:0.7,0.3", "short=ggx:0.9,0.5"],
}


def by_program(program, name, samples, runs):
    """Means of the quarters of each run, and processor seconds."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        # Blocks without a diffuse part.
        kd = {**KD, "tall": [0.0] * 3, "short": [0.0] * 3}
        lines = [f"newmtl {m}\nKd {r} {g} {b}\n" + ("Ke 17 12 4\n" if m == "light" else "") for m, (r, g, b) in kd.items()]
        (folder / "box.mtl").write_text("".join(lines))
        text = MESH.with_name("cornell-glossy.obj").read_text().replace("cornell-glossy.mtl", "box.mtl")
        (folder / "box.obj").write_text(text)
        options = [word for model in MODELS[name] for word in ("--model", model)]
        view = "--width 2 --height 2 --eye 278,273,-800 --look-at 278,273,0 --fov 39.3 --threads 1 --quiet".split()

        def run(samples, seed):
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            words = ["render", folder / "box.obj", "-o", folder / "o.exr", "--spp", str(samples), "--seed", str(seed)]
            subprocess.run([program, *words, *view, *options], check=True)
            picture = np.array(mi.Bitmap(str(folder / "o.exr")))[:, :, :3]
            return picture, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before

        starting = np.mean([run(1, seed)[1] for seed in range(20)])
        found = [run(samples, seed) for seed in range(runs)]
        return np.array([picture for picture, _ in found]), sum(seconds - starting for _, seconds in found)


def main():
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 1 << 15
    runs = int(sys.argv[2]) if len(sys.argv) > 2 else 16
    print(f"Mitsuba {mi.__version__}, {samples} samples a quarter, {runs} runs")
    for name, blocks in SCENES.items():
        made, start = scene(blocks), time.process_time()
        found = np.array([np.array(mi.render(made, spp=samples, seed=s)) for s in range(runs)])
        seconds = time.process_time() - start
        error = found.std(axis=0, ddof=1) / np.sqrt(runs)
        print(f"{name}: {seconds:.1f} processor seconds, {4 * samples * runs / seconds / 1e6:.3f} million paths a second")
        for row in range(2):
            for column in range(2):
                mean, se = found.mean(axis=0)[row, column], error[row, column]
                print(f"    ({np.array2string(mean[:3], precision=6, separator=', ')}, "
                      f"{np.array2string(se[:3], precision=6, separator=', ')}),")
        if len(sys.argv) > 3:
            ours, own_seconds = by_program(sys.argv[3], name, samples, runs)
            print(f"  the program: {own_seconds:.1f} processor seconds")
            for row in range(2):
                for column in range(2):
                    own, other = (x[:, row, column, :3].var(axis=0, ddof=1) for x in (ours, found))
                    costs = own * own_seconds / (other * seconds)
                    print(f"  time for the same variance, R G B: {np.array2string(costs, precision=2, separator=' ')}")


main()
