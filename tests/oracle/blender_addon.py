"""Use the add-on in Blender as a user would; prints one JSON object.

blender -b --python-exit-code 1 --python tests/oracle/blender_addon.py -- addon.py URL COMMAND hero.glb
"""

import importlib.util
import json
import sys

import bpy
import numpy as np
from mathutils import Matrix, Vector

vars(np).setdefault("bool", bool)  # Debian's Blender 3.4 has a NumPy that has dropped it
addon_path, url, command, hero = sys.argv[sys.argv.index("--") + 1 :]
specification = importlib.util.spec_from_file_location("blender_kinegraph", addon_path)
addon = importlib.util.module_from_spec(specification)
specification.loader.exec_module(addon)
bpy.ops.wm.read_homefile(use_empty=True)
addon.register()
bpy.context.scene.render.fps = 20
settings = bpy.context.scene.kinegraph
settings.text, settings.seconds, settings.seed, settings.takes = "a person walks", 2.0, 5, 2
settings.url, settings.command = url, command
found = {"made": list(bpy.ops.kinegraph.make())}
found["actions"] = sorted(action.name for action in bpy.data.actions)
bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.delete()


def points(armature, joints):
    first, last = (round(frame) for frame in armature.animation_data.action.frame_range)
    rows = []
    for frame in range(first, last + 1):
        bpy.context.scene.frame_set(frame)
        heads = [armature.matrix_world @ armature.pose.bones[name].head for name in joints]
        rows.append([[head.x, head.z, -head.y] for head in heads])
    return rows


bpy.ops.import_scene.gltf(filepath=hero)
armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
bpy.context.view_layer.objects.active = armature
settings.onto, settings.takes = True, 1
count = len(bpy.data.objects)
found["onto"] = list(bpy.ops.kinegraph.make())
found["left_over"] = len(bpy.data.objects) - count
found["action"] = armature.animation_data.action.name
found["joints"] = ["thigh_l", "calf_l", "foot_l", "upperarm_r", "lowerarm_r", "hand_r"]
found["points"] = points(armature, found["joints"])

# a bend to the right that starts away from the origin, on a turned and scaled object
data = bpy.data.curves.new("bend", "CURVE")
data.dimensions, data.bevel_depth = "3D", 0.1
spline = data.splines.new("BEZIER")
spline.bezier_points.add(1)
for point, place in zip(spline.bezier_points, [(0, 0, 0), (0.5, 1.0, 0)], strict=True):
    point.co, point.handle_left_type, point.handle_right_type = place, "FREE", "FREE"
spline.bezier_points[0].handle_right = (0, 0.5, 0)
spline.bezier_points[1].handle_left = (0.25, 1.0, 0)
bend = bpy.data.objects.new("bend", data)
bpy.context.collection.objects.link(bend)
bend.matrix_world = Matrix.Translation((3, 2, 0)) @ Matrix.Rotation(0.7, 4, "Z") @ Matrix.Scale(2.0, 4)
settings.path, count = bend, len(bpy.data.objects)
found["onto_path"] = list(bpy.ops.kinegraph.make())
found["path_left_over"] = len(bpy.data.objects) - count
found["walked"] = {"onto": points(armature, ["pelvis"])}
settings.onto = False
before = set(bpy.data.objects)
found["made_path"] = list(bpy.ops.kinegraph.make())
walker = next(thing for thing in set(bpy.data.objects) - before if thing.type == "ARMATURE")
found["walked"]["made"] = points(walker, ["pelvis"])
found["asked"] = [list(place) for place in addon.path_of(bend)[0]]
found["bend"] = []
for step in range(101):
    u = step / 100
    weights = ((1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3)
    corners = [(0, 0, 0), (0, 0.5, 0), (0.25, 1, 0), (0.5, 1, 0)]
    place = sum((w * Vector(p) for w, p in zip(weights, corners, strict=True)), Vector())
    place = bend.matrix_world @ place
    found["bend"].append([place.x, place.z, -place.y])
settings.path = None
settings.text = ""
try:
    found["empty"] = list(bpy.ops.kinegraph.make())
except RuntimeError as error:
    found["empty"] = str(error)
addon.unregister()
print(json.dumps(found))
