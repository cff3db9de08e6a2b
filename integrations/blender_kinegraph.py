"""Blender add-on: clips from sentences, as new armatures or on the selected one. One file; Blender 3.4 and later.

Install it with Edit > Preferences > Add-ons > Install from Disk. The panel is in the sidebar of the 3D view (N).
Clips come from `kinegraph serve`, or from the command `kinegraph` where no server answers. "Onto the selected armature"
needs the command: it exports the armature, runs `kinegraph retarget`, and copies the motion bone by bone.
"""

import json
import shlex
import subprocess
import tempfile
import urllib.error
import urllib.request
from math import atan2
from pathlib import Path

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from mathutils import Matrix

bl_info = {
    "name": "kinegraph",
    "author": "the kinegraph authors",
    "version": (1, 0, 0),
    "blender": (3, 4, 0),
    "location": "View3D > Sidebar > kinegraph",
    "description": "Human motion from sentences",
    "category": "Animation",
}
TIMEOUT = 120
"""Seconds for one clip."""
MOST_POINTS = 100
"""Of a path."""


class Failed(Exception):
    """A clip could not be made; the message is shown to the user."""


class KinegraphSettings(bpy.types.PropertyGroup):
    """What the panel shows; kept in the scene."""

    text: StringProperty(name="Text", default="a person walks forward and waves the right hand")
    seconds: FloatProperty(name="Seconds", default=4.0, min=0.5, max=10.0)
    seed: IntProperty(name="Seed", default=1, min=0)
    takes: IntProperty(name="Takes", default=1, min=1, max=16, description="Clips of following seeds")
    in_place: BoolProperty(name="In place", description="Without travel over the floor")
    path: PointerProperty(
        name="Path",
        type=bpy.types.Object,
        poll=lambda _, thing: thing.type == "CURVE",
        description="Curve to walk along from its start to its end, seen from above",
    )
    onto: BoolProperty(name="Onto the selected armature", description="Needs the command kinegraph")
    url: StringProperty(name="Server", default="http://127.0.0.1:8421", description="Of kinegraph serve")
    token: StringProperty(name="Token", subtype="PASSWORD")
    command: StringProperty(name="Command", default="kinegraph", description="Used for Onto, and without a server")


def fetch(settings, seed, suffix, path, points):
    """Write a clip to a file: by the server, or by the command where no server answers."""
    wanted = {"text": settings.text, "seconds": settings.seconds, "seed": seed, "format": suffix}
    wanted |= {"in_place": settings.in_place, "fps": bpy.context.scene.render.fps}
    if points:
        wanted["constraints"] = [{"type": "path", "points": points}]
    headers = {"Content-Type": "application/json"}
    if settings.token:
        headers["Authorization"] = f"Bearer {settings.token}"
    request = urllib.request.Request(f"{settings.url.rstrip('/')}/v1/clips", json.dumps(wanted).encode(), headers)
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as response:
            path.write_bytes(response.read())
        return
    except urllib.error.HTTPError as error:
        try:
            told = json.loads(error.read())["error"]
        except (ValueError, KeyError, TypeError):  # not an answer of ours
            told = str(error)
        raise Failed(told) from error
    except (urllib.error.URLError, TimeoutError, ValueError) as error:
        if isinstance(error, ValueError):
            raise Failed(f"{settings.url} is no address of a server") from error
    words = ["generate", settings.text, "--seconds", str(settings.seconds), "--seed", str(seed), "-o", str(path)]
    words += ["--fps", str(bpy.context.scene.render.fps), "--force", *(["--in-place"] if settings.in_place else [])]
    if points:
        words += ["--path=" + " ".join(f"{x:.4f},{z:.4f}" for x, z in points)]
    run(settings, words)


def run(settings, words):
    """Run the command kinegraph, and return what it prints."""
    # a path of Windows has signs that shlex takes for escapes
    command = [settings.command] if Path(settings.command).is_file() else shlex.split(settings.command)
    try:
        done = subprocess.run([*command, *words], capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Failed(f"no server at {settings.url}, and the command does not run: {error}") from error
    if done.returncode:
        raise Failed(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"{settings.command} failed")
    return done.stdout


def path_of(curve):
    """Read a curve as a path of the service, and where it starts.

    Blender's z is up, ours is y: a person that faces our +Z faces Blender's -Y.

    Returns:
        [[x, z], ...] of a person who starts at the origin and faces +Z along the curve, and the matrix that brings such
        a person to its start.
    """
    if len(curve.data.splines) != 1:
        raise Failed(f"{curve.name} has {len(curve.data.splines)} splines; a path is one")
    data = curve.data.copy()
    data.dimensions, data.bevel_mode, data.bevel_depth, data.extrude = "3D", "ROUND", 0.0, 0.0
    bare = bpy.data.objects.new("path", data)
    places = [curve.matrix_world @ vertex.co for vertex in bare.to_mesh().vertices]
    closed = data.splines[0].use_cyclic_u
    bpy.data.objects.remove(bare)
    bpy.data.curves.remove(data)
    places = [each for index, each in enumerate(places) if not index or (each - places[index - 1]).xy.length > 1e-4]
    if len(places) < 2:
        raise Failed(f"{curve.name} has no length, seen from above")
    places += places[:1] if closed else []
    ahead = places[1] - places[0]
    start = Matrix.Translation(places[0]) @ Matrix.Rotation(atan2(ahead.x, -ahead.y), 4, "Z")
    back = start.inverted()
    step = -(-len(places) // MOST_POINTS)
    kept = [*places[:-1:step], places[-1]]
    return [[place.x, -place.y] for place in (back @ each for each in kept)], start


def stand_at(armature, left_hip, right_hip, start):
    """Move an armature so that it rests at the start of a path and faces along it; its hips say where it faces."""
    left, right = (armature.matrix_world @ armature.data.bones[name].head_local for name in (left_hip, right_hip))
    across, middle = left - right, (left + right) / 2
    # a person who faces -Y has the left side at +X
    turn = Matrix.Rotation(-atan2(across.y, across.x), 4, "Z")
    armature.matrix_world = start @ turn @ Matrix.Translation((-middle.x, -middle.y, 0.0)) @ armature.matrix_world


def import_armature(path):
    """Import a GLB and return its armature; what it brings is selected."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path))
    return next(thing for thing in bpy.data.objects if thing not in before and thing.type == "ARMATURE")


def export_armature(armature, path):
    """Export an armature at rest with the meshes that it moves."""
    meshes = [
        thing
        for thing in bpy.context.scene.objects
        if any(part.type == "ARMATURE" and part.object == armature for part in thing.modifiers)
    ]
    bpy.ops.object.select_all(action="DESELECT")
    for thing in [armature, *meshes]:
        thing.select_set(True)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.export_scene.gltf(
        filepath=str(path), export_format="GLB", use_selection=True, export_animations=False, export_def_bones=False
    )


def copy_motion(source, target, name):
    """Key the pose of `source` on `target`, whatever the axes of its bones.

    In armature space a bone moves by M = pose rest^-1, the same for both; the target's pose is M times its own rest.
    """
    scene = bpy.context.scene
    first, last = (round(frame) for frame in source.animation_data.action.frame_range)
    target.animation_data_create().action = bpy.data.actions.new(name)
    across = target.matrix_world.inverted() @ source.matrix_world
    bones = [bone for bone in target.pose.bones if bone.name in source.pose.bones]
    before = {}
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        poses = {}
        for bone in target.pose.bones:  # parents come first
            rest, parent = bone.bone.matrix_local, bone.parent
            local = parent.bone.matrix_local.inverted() @ rest if parent else rest
            above = poses[parent.name] if parent else Matrix.Identity(4)
            if bone.name in source.pose.bones:
                theirs = source.pose.bones[bone.name]
                poses[bone.name] = (
                    across @ theirs.matrix @ theirs.bone.matrix_local.inverted() @ across.inverted() @ rest
                )
            else:
                poses[bone.name] = above @ local
            bone.matrix_basis = (above @ local).inverted() @ poses[bone.name]
        for bone in bones:
            bone.rotation_mode = "QUATERNION"
            if bone.name in before:  # q and -q turn alike, and between keys of both a bone would go the long way
                bone.rotation_quaternion.make_compatible(before[bone.name])
            before[bone.name] = bone.rotation_quaternion.copy()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
            if bone.parent is None or bone.parent.name not in source.pose.bones or not bone.bone.use_connect:
                bone.keyframe_insert("location", frame=frame)


def move_selected(settings, armature, seed, folder, name, points, start):
    """Make one take as an action of an armature, and put that at the start of the path."""
    clip, hero, moves = folder / "clip.npz", folder / "hero.glb", folder / "moves.glb"
    export_armature(armature, hero)
    words = ["retarget", str(clip), str(hero), "-o", str(moves), "--fps", str(bpy.context.scene.render.fps), "--json"]

    def retargeted(path):
        fetch(settings, seed, "npz", clip, path)
        return json.loads(run(settings, [*words, "--force"]))

    found = retargeted(points)
    if start and abs(found["scale"] - 1.0) > 0.01:  # a smaller character needs more of our steps for the same path
        found = retargeted([[x / found["scale"], z / found["scale"]] for x, z in points])
    before = set(bpy.data.objects)
    copy_motion(import_armature(moves), armature, name)
    for thing in set(bpy.data.objects) - before:
        bpy.data.objects.remove(thing)
    bpy.context.view_layer.objects.active = armature
    if start:
        stand_at(armature, found["bones"]["left_hip"], found["bones"]["right_hip"], start)


class KINEGRAPH_OT_make(bpy.types.Operator):
    """Make clips of the sentence"""

    bl_idname = "kinegraph.make"
    bl_label = "Make"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        """Make all takes, and say what went wrong."""
        settings = context.scene.kinegraph
        armature = context.view_layer.objects.active
        try:
            if settings.onto and (armature is None or armature.type != "ARMATURE"):
                raise Failed("select the armature that is to move")
            with tempfile.TemporaryDirectory(prefix="kinegraph-") as folder:
                for seed in range(settings.seed, settings.seed + settings.takes):
                    self.make(settings, armature, seed, Path(folder))
        except Failed as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def make(self, settings, armature, seed, folder):
        """Make one take, as a new armature or as an action of the selected one."""
        name = f"{settings.text[:40]} {seed}"
        points, start = path_of(settings.path) if settings.path else ([], None)
        if settings.onto:
            move_selected(settings, armature, seed, folder, name, points, start)
            return
        fetch(settings, seed, "glb", folder / "clip.glb", points)
        made = import_armature(folder / "clip.glb")
        made.animation_data.action.name = name
        if start:
            made.matrix_world = start @ made.matrix_world


class KINEGRAPH_PT_panel(bpy.types.Panel):
    """Panel of the sidebar."""

    bl_label = "kinegraph"
    bl_idname = "KINEGRAPH_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "kinegraph"

    def draw(self, context):
        """Lay out the settings and the button."""
        settings, layout = context.scene.kinegraph, self.layout
        layout.prop(settings, "text", text="")
        for row in (("seconds", "seed"), ("takes", "in_place")):
            line = layout.row(align=True)
            for name in row:
                line.prop(settings, name)
        layout.prop(settings, "path")
        layout.prop(settings, "onto")
        layout.operator("kinegraph.make", icon="PLAY")
        for name in ("url", "token", "command"):
            layout.prop(settings, name)


CLASSES = (KinegraphSettings, KINEGRAPH_OT_make, KINEGRAPH_PT_panel)


def register():
    """Add the panel."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.kinegraph = PointerProperty(type=KinegraphSettings)


def unregister():
    """Remove the panel."""
    del bpy.types.Scene.kinegraph
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)


if __name__ == "__main__":
    register()
