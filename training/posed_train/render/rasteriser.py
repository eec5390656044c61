"""The fast engine: MuJoCo's off-screen rasteriser (OpenGL through EGL), with shadows but no reflected light."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import cv2
import mujoco
import numpy as np

from .layout import (
    FOCAL_PX,
    HEIGHT,
    WIDTH,
    Camera,
    Camouflage,
    Clutter,
    Layout,
    Light,
    direction,
    random_colour,
    random_tint,
)
from .objects import ObjectMesh

MAX_OBJECTS = 5  # MuJoCo has six geometry groups: one for each object and group 0 for everything else
TEXTURE_SIZE = 256
SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}


class Rasteriser:
    tumbled = 0.4

    def __init__(self, objects: list[ObjectMesh], camouflage: Camouflage):
        if len(objects) > MAX_OBJECTS:
            raise ValueError(f"{len(objects)} objects; the rasteriser shows at most {MAX_OBJECTS}")
        self.objects, self.camouflage = objects, camouflage
        self.renderer: mujoco.Renderer | None = None

    def open(self, layout: Layout, rng: np.random.Generator) -> None:
        if self.renderer is not None:
            self.renderer.close()
        self.model = Scene(rng, self.camouflage).build(self.objects, layout)
        self.data = mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, HEIGHT, WIDTH)
        self.options = mujoco.MjvOption()
        self.geom_group = np.append(self.model.geom_group, -1)  # index -1 is the sky

    def place(self, world_from_object: list[np.ndarray]) -> None:
        for index, pose in enumerate(world_from_object):
            self.data.mocap_pos[index], self.data.mocap_quat[index] = pose[:3, 3], quaternion(pose[:3, :3])

    def colour(self, camera: Camera) -> np.ndarray:
        return self.render(camera, range(len(self.objects) + 1))

    def visible(self, camera: Camera) -> np.ndarray:
        """MuJoCo numbers what it sees by geometry; the sky is -1."""
        return np.maximum(self.geom_group[self.segment(camera, range(len(self.objects) + 1))], 0)

    def full_areas(self, camera: Camera) -> list[int]:
        return [int((self.segment(camera, [group + 1]) >= 0).sum()) for group in range(len(self.objects))]

    def segment(self, camera: Camera, groups) -> np.ndarray:
        self.renderer.enable_segmentation_rendering()
        geometry = self.render(camera, groups)[..., 0]
        self.renderer.disable_segmentation_rendering()
        return geometry

    def render(self, camera: Camera, groups) -> np.ndarray:
        pose = camera.world_from_opengl
        self.model.cam_pos[0], self.model.cam_quat[0] = pose[:3, 3], quaternion(pose[:3, :3])
        mujoco.mj_forward(self.model, self.data)
        self.options.geomgroup[:] = [int(group in groups) for group in range(6)]
        self.renderer.update_scene(self.data, camera=0, scene_option=self.options)
        return self.renderer.render()


class Scene:
    """Builds the MuJoCo model of a layout, drawing its materials."""

    def __init__(self, rng: np.random.Generator, camouflage: Camouflage):
        self.rng, self.camouflage, self.spec = rng, camouflage, mujoco.MjSpec()
        self.world = self.spec.worldbody
        self.spec.visual.quality.shadowsize = 2048
        self.spec.visual.quality.offsamples = 4
        self.spec.visual.global_.offwidth, self.spec.visual.global_.offheight = WIDTH, HEIGHT
        self.spec.visual.map.znear, self.spec.visual.map.zfar = 0.05, 20.0
        self.spec.stat.extent, self.spec.stat.center = 1.0, [0, 0, 0]

    def build(self, objects: list[ObjectMesh], layout: Layout) -> mujoco.MjModel:
        self.world.add_camera(name="camera", fovy=np.degrees(2 * np.arctan(HEIGHT / 2 / FOCAL_PX)))
        self.add_headlight()
        for light in layout.lights:
            self.add_light(light, len(layout.lights))
        self.add_surroundings(layout)
        for group, (item, pose) in enumerate(zip(objects, layout.world_from_object), start=1):
            self.add_object(group, item, pose)
        for clutter in layout.clutter:
            self.add_clutter(clutter)
        model = self.spec.compile()
        for address in model.tex_adr:  # filled in afterwards: the spec would take the pixels one by one
            texture = random_texture(self.rng, self.camouflage.colour(self.rng)).reshape(-1)
            model.tex_data[address : address + texture.size] = texture
        return model

    def add_headlight(self) -> None:
        rng, headlight = self.rng, self.spec.visual.headlight
        headlight.ambient = random_tint(rng) * rng.uniform(0.1, 0.45)
        headlight.diffuse = random_tint(rng) * (rng.uniform(0, 0.35) if rng.random() < 0.5 else 0)
        headlight.specular = np.full(3, rng.uniform(0, 0.3))

    def add_light(self, light: Light, count: int) -> None:
        rng, kinds = self.rng, mujoco.mjtLightType
        diffuse = light.tint * rng.uniform(0.35, 1.1) / count**0.6
        self.world.add_light(
            pos=light.position,
            dir=-light.position / np.linalg.norm(light.position),
            type=kinds.mjLIGHT_DIRECTIONAL if rng.random() < 0.3 else kinds.mjLIGHT_SPOT,
            diffuse=diffuse,
            specular=diffuse * rng.uniform(0.1, 1.2),
            ambient=[0, 0, 0],
            cutoff=80,
            exponent=rng.uniform(0, 6),
            castshadow=bool(rng.random() < 0.8),
        )

    def random_material(self) -> str:
        rng, name = self.rng, f"material{len(self.spec.materials)}"
        material = self.spec.add_material(
            name=name, specular=rng.uniform(0, 1), shininess=rng.uniform(0, 1), reflectance=0.0
        )
        if rng.random() < 0.25:
            colour = self.camouflage.colour(rng)
            material.rgba = [*(random_colour(rng) if colour is None else colour), 1]
            return name
        self.spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            width=TEXTURE_SIZE,
            height=TEXTURE_SIZE,
            nchannel=3,
        )
        textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
        textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        material.textures = textures
        material.texuniform = True
        material.texrepeat = np.full(2, np.exp(rng.uniform(np.log(0.7), np.log(12))))
        return name

    def add_surroundings(self, layout: Layout) -> None:
        plane, half = mujoco.mjtGeom.mjGEOM_PLANE, layout.table_half_m
        self.world.add_geom(type=plane, size=[half, half, 0.1], material=self.random_material())
        self.world.add_geom(type=plane, size=[15, 15, 0.1], pos=[0, 0, layout.floor_z], material=self.random_material())
        for wall in layout.walls:
            self.world.add_geom(
                type=plane,
                size=[8, 8, 0.1],
                pos=wall.position,
                zaxis=-direction(wall.azimuth, 0),
                material=self.random_material(),
            )

    def add_object(self, group: int, item: ObjectMesh, world_from_object: np.ndarray) -> None:
        rng = self.rng
        finish = {"specular": rng.uniform(0, 1), "shininess": rng.uniform(0.05, 1)}
        brightness = rng.uniform(0.55, 1.2)
        # A body that may be put elsewhere without building the scene anew.
        body = self.world.add_body(mocap=True, pos=world_from_object[:3, 3], quat=quaternion(world_from_object[:3, :3]))
        for number, part in enumerate(item.parts):  # MuJoCo has one colour a geometry
            name = f"object{group}_{number}"
            tint = np.clip(part.colour * brightness * rng.uniform(0.92, 1.08, 3) + rng.uniform(0, 0.06), 0, 1)
            self.spec.add_material(name=name, rgba=[*tint, 1], **finish)
            triangles = item.mesh.triangles[part.faces]
            normals = np.repeat(item.mesh.face_normals[part.faces], 3, axis=0)
            self.spec.add_mesh(
                name=name,
                uservert=triangles.reshape(-1),
                userface=np.arange(3 * len(triangles)),
                usernormal=normals.reshape(-1),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=name,
                material=name,
                group=group,
                contype=0,
                conaffinity=0,
            )

    def add_clutter(self, clutter: Clutter) -> None:
        self.world.add_geom(
            type=int(SHAPES[clutter.shape]),
            size=clutter.half_size,
            pos=clutter.world_from_clutter[:3, 3],
            quat=quaternion(clutter.world_from_clutter[:3, :3]),
            material=self.random_material(),
        )


def quaternion(rotation: np.ndarray) -> np.ndarray:
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, rotation.flatten())
    return q


def random_texture(rng: np.random.Generator, colour: np.ndarray | None) -> np.ndarray:
    """Square RGB: noise of several scales, stripes, checks or blobs between two colours, of which the first may be
    given."""
    size = TEXTURE_SIZE
    first, second = random_colour(rng), random_colour(rng)
    first = first if colour is None else colour
    kind = rng.choice(["noise", "stripes", "checks", "blobs"])
    if kind == "noise":
        field = sum(
            cv2.resize(rng.random((n, n)), (size, size), interpolation=cv2.INTER_CUBIC) * w
            for n, w in ((4, 1.0), (12, 0.6), (40, 0.4), (128, 0.25))
        )
    elif kind == "stripes":
        x = np.linspace(0, 2 * np.pi * rng.integers(2, 12), size)
        field = np.sin(x[None, :] + 2 * np.cos(np.linspace(0, 2 * np.pi, size))[:, None] * rng.uniform(0, 2))
    elif kind == "checks":
        n = rng.integers(2, 16)
        field = np.kron(np.indices((n, n)).sum(0) % 2, np.ones((size // n + 1,) * 2))[:size, :size].astype(float)
    else:
        field = cv2.GaussianBlur(rng.random((size, size)), (0, 0), rng.uniform(2, 14))
        field = (field > np.median(field)).astype(float)
    field = (field - field.min()) / max(np.ptp(field), 1e-9)
    field = np.clip((field - rng.uniform(0, 0.3)) / rng.uniform(0.4, 0.9), 0, 1)[..., None]
    return np.ascontiguousarray((first * (1 - field) + second * field) * 255).astype(np.uint8)
