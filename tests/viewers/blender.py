#!/usr/bin/env python3
"""Imports a lit glTF file into Blender and renders it with Cycles.

usage: blender.py SCENE.glb OURS.png EYE LOOK-AT UP FOV PICTURE.png       (pip install bpy)

EYE, LOOK-AT and UP are x,y,z and FOV is in degrees, as `radiosity render` takes them. Prints JSON: the number of triangles, the bounds and
the area of what was imported in the coordinates of the file, the materials that emit a texture by their emission strength, and the mean
difference of the picture from OURS.png in 1/255."""
import json
import math
import sys

import bpy
from mathutils import Matrix, Vector

glb, ours, eye, look_at, up, fov, picture = sys.argv[1:8]


def point(text):
    """A point of the file, y up, in Blender's coordinates, z up."""
    x, y, z = map(float, text.split(","))
    return Vector((x, -z, y))


bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=glb)
scene = bpy.context.scene

triangles, area, corners = 0, 0.0, []
for thing in scene.objects:
    if thing.type != "MESH":
        continue
    mesh = thing.data
    mesh.calc_loop_triangles()
    triangles += len(mesh.loop_triangles)
    for triangle in mesh.loop_triangles:
        a, b, c = (thing.matrix_world @ mesh.vertices[i].co for i in triangle.vertices)
        area += 0.5 * (b - a).cross(c - a).length
        corners += [(p.x, p.z, -p.y) for p in (a, b, c)]
bounds = [[f(p[k] for p in corners) for k in range(3)] for f in (min, max)]

emitting = {}
for material in bpy.data.materials:
    shaders = [n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"]
    for shader in shaders:
        if shader.inputs["Emission Color"].is_linked:
            emitting[material.name] = shader.inputs["Emission Strength"].default_value

camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
back = (point(eye) - point(look_at)).normalized()
right = point(up).cross(back).normalized()
camera.matrix_world = Matrix.Translation(point(eye)) @ Matrix((right, back.cross(right), back)).transposed().to_4x4()
distance = (point(eye) - point(look_at)).length
camera.data.sensor_fit = "VERTICAL"
camera.data.angle_y = math.radians(float(fov))
camera.data.clip_start, camera.data.clip_end = distance / 1000, distance * 100
scene.camera = camera

scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.samples = 16
scene.cycles.use_denoising = False
scene.cycles.use_adaptive_sampling = False
scene.cycles.pixel_filter_type = "BOX"
# The light is in the emission: nothing is left to be reflected.
scene.cycles.max_bounces = 0
scene.view_settings.view_transform = "Standard"
wanted = bpy.data.images.load(ours)
scene.render.resolution_x, scene.render.resolution_y = wanted.size
scene.render.image_settings.file_format = "PNG"
scene.render.filepath = picture
bpy.ops.render.render(write_still=True)
shown = bpy.data.images.load(picture)
channels = [k for k in range(len(wanted.pixels)) if k % wanted.channels < 3]
if shown.channels != wanted.channels:
    sys.exit(f"{shown.channels} channels for {wanted.channels}")
a, b = list(shown.pixels), list(wanted.pixels)
difference = 255 * sum(abs(a[k] - b[k]) for k in channels) / len(channels)
print("\n" + json.dumps({"triangles": triangles, "area": area, "bounds": bounds, "emitting": emitting, "difference": difference}))
