"""The photoreal engine: Blender's path tracer (PyPI `bpy`, which wants a Python environment of its own)."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import cv2
import numpy as np
import trimesh
from mathutils import Matrix, Vector

from .layout import (
    FOCAL_PX,
    HEIGHT,
    WIDTH,
    Camera,
    Camouflage,
    Clutter,
    Layout,
    Light,
    Wall,
    random_colour,
    random_tint,
)
from .objects import ObjectMesh, Part

SAMPLES = 4
BOUNCES = 4
INDEX_STEP = 16
"""Between the grey values by which objects are told apart in an 8-bit image."""
TEXTURES = ("Noise", "Voronoi", "Brick", "Checker", "Wave", "Magic")


class Cycles:
    tumbled = 0.0

    def __init__(self, objects: list[ObjectMesh], camouflage: Camouflage):
        if len(objects) > 255 // INDEX_STEP:
            raise ValueError(f"{len(objects)} objects; their masks hold at most {255 // INDEX_STEP}")
        self.camouflage = camouflage
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.folder = tempfile.TemporaryDirectory()
        self.picture = Path(self.folder.name) / "picture.png"
        # Lights are left out of the second scene: masks are taken without any.
        self.photo, self.masks = photo_scene(str(self.picture)), mask_scene(str(self.picture))
        self.camera = new_camera()
        self.objects = [new_object(item, index + 1) for index, item in enumerate(objects)]
        for thing in (self.camera, *self.objects):
            self.add(thing)
        self.photo.camera = self.masks.camera = self.camera
        self.kept = set(bpy.data.objects), set(bpy.data.materials), set(bpy.data.meshes)

    def add(self, thing: bpy.types.Object) -> None:
        for scene in (self.photo, self.masks):
            scene.collection.objects.link(thing)

    def open(self, layout: Layout, rng: np.random.Generator) -> None:
        self.clear()
        self.rng = rng
        light_world(self.photo, rng)
        for light in layout.lights:
            self.photo.collection.objects.link(new_light(light, rng))
        self.add(plane("table", layout.table_half_m, Matrix(), self.random_material()))
        self.add(plane("floor", 15, Matrix.Translation((0, 0, layout.floor_z)), self.random_material()))
        for wall in layout.walls:
            self.add(plane("wall", 4, world_from_wall(wall), self.random_material()))
        for clutter in layout.clutter:
            self.add(new_clutter(clutter, self.random_material()))
        self.place(layout.world_from_object)
        for thing in self.objects:
            vary_finish(thing, rng)

    def place(self, world_from_object: list[np.ndarray]) -> None:
        for thing, pose in zip(self.objects, world_from_object):
            thing.matrix_world = Matrix(pose.tolist())

    def random_material(self) -> bpy.types.Material:
        return random_material(self.rng, self.camouflage.colour(self.rng))

    def clear(self) -> None:
        """Removes what the last scene added."""
        objects, materials, meshes = self.kept
        for data, kept in ((bpy.data.objects, objects), (bpy.data.materials, materials), (bpy.data.meshes, meshes)):
            bpy.data.batch_remove(set(data) - kept)
        bpy.data.batch_remove(set(bpy.data.lights))

    def colour(self, camera: Camera) -> np.ndarray:
        self.photo.view_settings.exposure = self.rng.uniform(-0.4, 0.5)
        self.photo.cycles.seed = int(self.rng.integers(2**31))
        return self.render(self.photo, camera)

    def visible(self, camera: Camera) -> np.ndarray:
        return np.rint(self.render(self.masks, camera)[..., 0] / INDEX_STEP).astype(int)

    def full_areas(self, camera: Camera) -> list[int]:
        """Each object is rendered with all else hidden."""
        things = [thing for thing in self.masks.collection.objects if thing.type == "MESH"]
        areas = []
        for shown in self.objects:
            for thing in things:
                thing.hide_render = thing != shown
            areas.append(int((self.visible(camera) > 0).sum()))
        for thing in things:
            thing.hide_render = False
        return areas

    def render(self, scene: bpy.types.Scene, camera: Camera) -> np.ndarray:
        self.camera.matrix_world = Matrix(camera.world_from_opengl.tolist())
        with quiet():
            bpy.ops.render.render(write_still=True, scene=scene.name)
        return cv2.cvtColor(cv2.imread(str(self.picture), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


@contextmanager
def quiet() -> Iterator[None]:
    """Blender reports every picture on standard output, below Python's `sys.stdout`."""
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def new_scene(name: str, samples: int, picture: str) -> bpy.types.Scene:
    scene = bpy.data.scenes.new(name)
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", samples
    scene.cycles.use_adaptive_sampling = False
    scene.render.use_persistent_data = True
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.filepath = picture
    scene.render.image_settings.file_format, scene.render.image_settings.compression = "PNG", 0
    return scene


def photo_scene(picture: str) -> bpy.types.Scene:
    scene = new_scene("photo", SAMPLES, picture)
    scene.cycles.max_bounces = BOUNCES
    # Made for scenes of many lights; with three it only costs time.
    scene.cycles.use_light_tree = False
    # Its fast mode takes less time than one more sample, and leaves four about as clean as eight.
    scene.cycles.use_denoising = True
    scene.cycles.denoising_quality = scene.cycles.denoising_prefilter = "FAST"
    scene.view_settings.view_transform = "Standard"
    return scene


def mask_scene(picture: str) -> bpy.types.Scene:
    """Every surface glows in the grey of its object's index; one sample at the pixel's centre, no other light."""
    scene = new_scene("masks", 1, picture)
    scene.cycles.max_bounces = 0
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    scene.view_settings.view_transform = "Raw"
    scene.render.dither_intensity = 0
    scene.world = bpy.data.worlds.new("dark")
    nodes, link = new_nodes(scene.world)
    link(nodes.new("ShaderNodeBackground").outputs[0], nodes.new("ShaderNodeOutputWorld").inputs[0])
    nodes["Background"].inputs["Strength"].default_value = 0
    material = bpy.data.materials.new("index")
    nodes, link = new_nodes(material)
    info, scaled = nodes.new("ShaderNodeObjectInfo"), nodes.new("ShaderNodeMath")
    glow, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    scaled.operation, scaled.inputs[1].default_value = "MULTIPLY", INDEX_STEP / 255
    link(info.outputs["Object Index"], scaled.inputs[0])
    link(scaled.outputs[0], glow.inputs["Color"])
    link(glow.outputs[0], output.inputs["Surface"])
    scene.view_layers[0].material_override = material
    return scene


def new_nodes(owner):
    """The empty node tree of a material or world, and how to link two of its sockets."""
    owner.node_tree.nodes.clear()
    return owner.node_tree.nodes, owner.node_tree.links.new


def new_camera() -> bpy.types.Object:
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
    data.lens = FOCAL_PX * data.sensor_width / WIDTH
    data.clip_start = 0.01
    return bpy.data.objects.new("camera", data)


def new_mesh(name: str, mesh: trimesh.Trimesh) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    return bpy.data.objects.new(name, data)


def new_object(item: ObjectMesh, index: int) -> bpy.types.Object:
    thing = new_mesh(f"object{item.obj_id}", item.mesh)
    thing.pass_index = index
    slots = np.empty(len(item.mesh.faces), dtype=np.int32)
    for slot, part in enumerate(item.parts):
        thing.data.materials.append(part_material(thing.name, part))
        slots[part.faces] = slot
    thing.data.polygons.foreach_set("material_index", slots)
    return thing


def part_material(name: str, part: Part) -> bpy.types.Material:
    """Keeps the part's own colour: each scene varies it anew."""
    material, shader = new_material(name)
    material["colour"] = linear(part.colour).tolist()
    shader["Metallic"].default_value = part.metallic
    return material


def vary_finish(thing: bpy.types.Object, rng: np.random.Generator) -> None:
    """Colours and roughness as under other cameras and after wear."""
    brightness = rng.uniform(0.75, 1.25)
    for material in thing.data.materials:
        shader = material.node_tree.nodes["Principled BSDF"].inputs
        own = np.array(material["colour"])
        tint = np.clip(own * brightness * rng.uniform(0.88, 1.12, 3) + rng.uniform(0, 0.012), 0, 1)
        shader["Base Color"].default_value = (*tint, 1)
        shader["Roughness"].default_value = rng.uniform(0.15, 0.65)


def linear(srgb: np.ndarray) -> np.ndarray:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def new_material(name: str):
    """A material and the inputs of its shader."""
    material = bpy.data.materials.new(name)
    nodes, link = new_nodes(material)
    shader, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    link(shader.outputs[0], output.inputs["Surface"])
    return material, shader.inputs


def random_material(rng: np.random.Generator, colour: np.ndarray | None) -> bpy.types.Material:
    """Plain, or a procedural texture between two colours, of which the first may be given, sRGB."""
    material, shader = new_material("random")
    shader["Roughness"].default_value = rng.uniform(0.15, 0.95)
    shader["Metallic"].default_value = float(rng.random() < 0.15)
    first, second = (random_colour(rng) ** 1.5 for _ in range(2))
    first = first if colour is None else linear(colour)
    if rng.random() < 0.2:
        shader["Base Color"].default_value = (*first, 1)
        return material
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    kind = rng.choice(TEXTURES)
    texture = nodes.new(f"ShaderNodeTex{kind}")
    link(mapping(nodes, link, rng), texture.inputs["Vector"])
    if kind in ("Brick", "Checker"):
        texture.inputs["Color1"].default_value, texture.inputs["Color2"].default_value = (*first, 1), (*second, 1)
        link(texture.outputs["Color"], shader["Base Color"])
        return material
    ramp = nodes.new("ShaderNodeValToRGB")
    low, high = ramp.color_ramp.elements
    low.color, high.color = (*first, 1), (*second, 1)
    low.position, high.position = rng.uniform(0.1, 0.45), rng.uniform(0.55, 0.9)
    value = next((o for o in texture.outputs if o.name in ("Fac", "Factor", "Distance")), texture.outputs[0])
    link(value, ramp.inputs[0])
    link(ramp.outputs["Color"], shader["Base Color"])
    return material


def mapping(nodes, link, rng: np.random.Generator):
    """Texture coordinates in the object's own frame, scaled and turned at random."""
    place = nodes.new("ShaderNodeMapping")
    scale = np.exp(rng.uniform(np.log(2), np.log(60)))
    place.inputs["Scale"].default_value = (scale, scale * rng.uniform(0.3, 1.5), scale)
    place.inputs["Rotation"].default_value = (0, 0, rng.uniform(0, 2 * np.pi))
    link(nodes.new("ShaderNodeTexCoord").outputs["Object"], place.inputs["Vector"])
    return place.outputs["Vector"]


def light_world(scene: bpy.types.Scene, rng: np.random.Generator) -> None:
    scene.world = scene.world or bpy.data.worlds.new("sky")
    nodes, link = new_nodes(scene.world)
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (*random_tint(rng), 1)
    background.inputs["Strength"].default_value = rng.uniform(0.08, 0.45)
    link(background.outputs[0], nodes.new("ShaderNodeOutputWorld").inputs[0])


def new_light(light: Light, rng: np.random.Generator) -> bpy.types.Object:
    """An area light; its power grows with the distance so that the table is lit alike."""
    data = bpy.data.lights.new("light", "AREA")
    towards = Vector(light.position)
    data.energy = rng.uniform(3, 16) * towards.length_squared / 2
    data.size, data.color = rng.uniform(0.1, 1.2), light.tint
    lamp = bpy.data.objects.new("light", data)
    lamp.location, lamp.rotation_euler = towards, (-towards).to_track_quat("-Z", "Y").to_euler()
    return lamp


def plane(name: str, half_m: float, pose: Matrix, material: bpy.types.Material) -> bpy.types.Object:
    corners = [[-half_m, -half_m, 0], [half_m, -half_m, 0], [half_m, half_m, 0], [-half_m, half_m, 0]]
    thing = new_mesh(name, trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False))
    thing.matrix_world = pose
    thing.data.materials.append(material)
    return thing


def world_from_wall(wall: Wall) -> Matrix:
    turned = Matrix.Rotation(wall.azimuth - np.pi / 2, 4, "Z") @ Matrix.Rotation(np.pi / 2, 4, "X")
    return Matrix.Translation(wall.position) @ turned


def new_clutter(clutter: Clutter, material: bpy.types.Material) -> bpy.types.Object:
    x, y, z = clutter.half_size
    if clutter.shape == "box":
        mesh = trimesh.creation.box(2 * clutter.half_size)
    elif clutter.shape == "cylinder":
        mesh = trimesh.creation.cylinder(x, 2 * y)
    elif clutter.shape == "capsule":
        mesh = trimesh.creation.capsule(2 * y, x)
    else:
        mesh = trimesh.creation.icosphere(3)
        mesh.apply_scale([x, y, z])
    thing = new_mesh("clutter", mesh)
    thing.matrix_world = Matrix(clutter.world_from_clutter.tolist())
    thing.data.materials.append(material)
    return thing
