"""Use the add-on in Blender as a user would; prints one JSON object.

blender -b --python-exit-code 1 --python tests/oracle/blender_addon.py -- addon.py URL COMMAND hero.glb
"""

import importlib.util
import json
import sys

import bpy
import numpy as np

np.bool = bool  # Debian's Blender 3.4 has a NumPy that has dropped it
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
settings.text = ""
try:
    found["empty"] = list(bpy.ops.kinegraph.make())
except RuntimeError as error:
    found["empty"] = str(error)
addon.unregister()
print(json.dumps(found))
