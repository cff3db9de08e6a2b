"""Where Blender puts the joints of a saved clip, beside where the clip has them; prints one JSON object.

    blender -b --python-exit-code 1 --python tests/oracle/blender_joints.py -- clip.npz clip.glb clip.bvh clip.fbx

runs inside Blender, and with `pip install bpy` (Blender as a module) Python runs it alone:

    python tests/oracle/blender_joints.py clip.npz clip.glb
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

if bpy.app.version < (3, 5):
    # Debian 12 ships Blender 3.4 with a NumPy and a Python that have dropped what its importers use.
    import io_anim_bvh.import_bvh

    np.bool = bool
    io_anim_bvh.import_bvh.open = lambda name, _mode, **rest: Path(name).open(**rest)  # noqa: SIM115


def imported(path: Path, fps: float) -> bpy.types.Object:
    """The armature of a file in an otherwise empty scene of that frame rate."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.context.scene.render.fps = round(fps)
    if path.suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=str(path), global_scale=0.01, frame_start=0)
    elif path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        bpy.ops.import_scene.fbx(filepath=str(path))
    (armature,) = (each for each in bpy.context.scene.objects if each.type == "ARMATURE")
    return armature


def joints(armature: bpy.types.Object, names: list[str], frames: int) -> np.ndarray:
    """(frames, 22, 3) metres, Y up: heads of the bones, from the first key on."""
    scene, found = bpy.context.scene, np.zeros((frames, len(names), 3))
    first = round(armature.animation_data.action.frame_range[0])
    for frame in range(frames):
        scene.frame_set(first + frame)
        for number, name in enumerate(names):
            x, y, z = armature.matrix_world @ armature.pose.bones[name].head
            found[frame, number] = x, z, -y
    return found


def rest_heights(armature: bpy.types.Object, names: list[str]) -> list[float]:
    """Metres above the floor of the lowest joint and of the first one, the pelvis, in the rest pose."""
    heights = [(armature.matrix_world @ armature.data.bones[name].head_local).z for name in names]
    return [min(heights), heights[0]]


def compared(path: Path, clip: dict[str, np.ndarray]) -> dict[str, object]:
    """Distances in millimetres, how long Blender takes the clip to be, the rest pose, and all that is in the file."""
    armature = imported(path, float(clip["fps"]))
    seen = joints(armature, clip["joint_names"].tolist(), len(clip["joints"]))
    apart = np.linalg.norm(seen - clip["joints"], axis=-1) * 1000
    start, end = armature.animation_data.action.frame_range
    meshes = [each for each in bpy.context.scene.objects if each.type == "MESH"]
    skinned = [each for each in meshes if any(part.type == "ARMATURE" for part in each.modifiers)]
    return {
        "mean_mm": float(apart.mean()),
        "max_mm": float(apart.max()),
        "frames": round(end - start) + 1,
        "skinned_vertices": sum(len(each.data.vertices) for each in skinned),
        "rest_heights": rest_heights(armature, clip["joint_names"].tolist()),
        "bones": [bone.name for bone in armature.data.bones],
        "objects": sorted(each.name for each in bpy.data.objects),
    }


def main(arguments: list[str]) -> None:
    with np.load(arguments[0], allow_pickle=False) as stored:
        clip = {name: stored[name] for name in stored.files}
    found = {Path(name).suffix: compared(Path(name).resolve(), clip) for name in arguments[1:]}
    print(json.dumps({"blender": bpy.app.version_string, **found}))


main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
