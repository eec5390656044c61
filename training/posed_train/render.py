"""Fast training images: random static scenes of known meshes, rasterised off-screen by MuJoCo.

Every scene holds all objects in random poses among clutter, under random lights and textures, seen by several
cameras. The result is a BOP-format folder (millimetres, OpenCV camera frame, pixel centre = integer coordinate)
with exact poses, boxes of the visible part, masks and visible fractions. It takes tens of milliseconds an image,
so it supplies the thousands of crops that training needs; validation belongs to photoreal renders and photos.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import cv2
import mujoco
import numpy as np
import trimesh
from tqdm import tqdm

WIDTH, HEIGHT, FOCAL_PX = 640, 480, 600.0
CAMERA_MATRIX = np.array([[FOCAL_PX, 0, (WIDTH - 1) / 2], [0, FOCAL_PX, (HEIGHT - 1) / 2], [0, 0, 1]])
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
MAX_OBJECTS = 5  # MuJoCo has six geometry groups: one for each object and group 0 for everything else
MIN_BOX_PX = 8
TEXTURE_SIZE = 256


@dataclass
class ObjectMesh:
    obj_id: int
    mesh: trimesh.Trimesh  # metres, vertex colours in sRGB
    resting_rotations: np.ndarray  # [n, 3, 3]


def load_objects(models_dir: Path) -> list[ObjectMesh]:
    """Reads every `obj_NNNNNN.ply` (millimetres, coloured vertices) of a BOP models folder."""
    objects = []
    for path in sorted(models_dir.glob("obj_*.ply")):
        mesh = trimesh.load(path, process=False)
        mesh.apply_scale(0.001)
        hull = mesh.convex_hull
        resting, _ = hull.compute_stable_poses(center_mass=hull.center_mass, sigma=0.0, n_samples=1, threshold=0.02)
        objects.append(ObjectMesh(int(path.stem.split("_")[1]), mesh, resting[:, :3, :3]))
    if not 1 <= len(objects) <= MAX_OBJECTS:
        raise ValueError(f"{models_dir}: {len(objects)} obj_*.ply files, expected 1 to {MAX_OBJECTS}")
    return objects


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q = rng.normal(size=4)
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, q / np.linalg.norm(q))
    return matrix.reshape(3, 3)


def rotation_about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def quaternion(rotation: np.ndarray) -> np.ndarray:
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, rotation.flatten())
    return q


def random_colour(rng: np.random.Generator) -> np.ndarray:
    colour = rng.uniform(0, 1, 3)
    return np.full(3, colour.mean()) if rng.random() < 0.4 else colour


class SceneBuilder:
    """Builds one MuJoCo model: a table, walls, clutter, lights and the objects."""

    def __init__(self, objects: list[ObjectMesh], rng: np.random.Generator):
        self.objects, self.rng = objects, rng
        self.spec = mujoco.MjSpec()
        self.world = self.spec.worldbody
        self.spec.visual.quality.shadowsize = 2048
        self.spec.visual.quality.offsamples = 4
        self.spec.visual.global_.offwidth, self.spec.visual.global_.offheight = WIDTH, HEIGHT
        self.spec.visual.map.znear, self.spec.visual.map.zfar = 0.05, 20.0
        self.spec.stat.extent, self.spec.stat.center = 1.0, [0, 0, 0]
        self.world_from_object: dict[int, np.ndarray] = {}

    def build(self) -> mujoco.MjModel:
        self.add_lights()
        self.add_surroundings()
        for group, item in enumerate(self.objects, start=1):
            self.add_object(group, item)
        for _ in range(self.rng.integers(4, 14)):
            self.add_clutter()
        model = self.spec.compile()
        for address in model.tex_adr:  # filled in afterwards: the spec would take the pixels one by one
            texture = random_texture(self.rng).reshape(-1)
            model.tex_data[address : address + texture.size] = texture
        return model

    def add_lights(self) -> None:
        rng, headlight = self.rng, self.spec.visual.headlight
        headlight.ambient = random_tint(rng) * rng.uniform(0.1, 0.45)
        headlight.diffuse = random_tint(rng) * (rng.uniform(0, 0.35) if rng.random() < 0.5 else 0)
        headlight.specular = np.full(3, rng.uniform(0, 0.3))
        count = rng.integers(1, 4)
        for _ in range(count):
            azimuth, elevation, distance = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.5), rng.uniform(0.9, 2.4)
            position = distance * direction(azimuth, elevation)
            diffuse = random_tint(rng) * rng.uniform(0.35, 1.1) / count**0.6
            self.world.add_light(
                pos=position,
                dir=-position / distance,
                type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
                if rng.random() < 0.3
                else mujoco.mjtLightType.mjLIGHT_SPOT,
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
            material.rgba = [*random_colour(rng), 1]
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

    def add_surroundings(self) -> None:
        rng, plane = self.rng, mujoco.mjtGeom.mjGEOM_PLANE
        half = rng.uniform(0.6, 3)
        self.world.add_geom(type=plane, size=[half, half, 0.1], material=self.random_material())
        self.world.add_geom(
            type=plane, size=[15, 15, 0.1], pos=[0, 0, -rng.uniform(0.05, 0.9)], material=self.random_material()
        )
        for quarter in range(4):
            azimuth = quarter * np.pi / 2 + rng.uniform(-0.3, 0.3)
            self.world.add_geom(
                type=plane,
                size=[8, 8, 0.1],
                pos=rng.uniform(1.5, 4) * direction(azimuth, 0),
                zaxis=-direction(azimuth, 0),
                material=self.random_material(),
            )

    def add_object(self, group: int, item: ObjectMesh) -> None:
        rng = self.rng
        if rng.random() < 0.6:
            rotation = item.resting_rotations[rng.integers(len(item.resting_rotations))]
            rotation = rotation_about_z(rng.uniform(0, 2 * np.pi)) @ rotation
        else:
            rotation = random_rotation(rng)
        world_from_object = np.eye(4)
        world_from_object[:3, :3] = rotation
        lowest = (item.mesh.vertices @ rotation.T)[:, 2].min()
        world_from_object[:3, 3] = [*self.free_spot(), -lowest + 0.0003]
        self.world_from_object[item.obj_id] = world_from_object
        finish = {"specular": rng.uniform(0, 1), "shininess": rng.uniform(0.05, 1)}
        brightness = rng.uniform(0.55, 1.2)
        for part, (faces, colour) in enumerate(parts_by_colour(item.mesh)):
            name = f"object{item.obj_id}_{part}"
            tint = np.clip(colour * brightness * rng.uniform(0.92, 1.08, 3) + rng.uniform(0, 0.06), 0, 1)
            self.spec.add_material(name=name, rgba=[*tint, 1], **finish)
            triangles = item.mesh.triangles[faces]
            normals = np.repeat(item.mesh.face_normals[faces], 3, axis=0)
            self.spec.add_mesh(
                name=name,
                uservert=triangles.reshape(-1),
                userface=np.arange(3 * len(triangles)),
                usernormal=normals.reshape(-1),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
            self.world.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=name,
                material=name,
                pos=world_from_object[:3, 3],
                quat=quaternion(rotation),
                group=group,
                contype=0,
                conaffinity=0,
            )

    def free_spot(self) -> np.ndarray:
        """A place on the table some way from the objects already there (they may still touch)."""
        taken = [t[:2, 3] for t in self.world_from_object.values()]
        for _ in range(50):
            spot = self.rng.normal(0, 0.11, 2)
            if all(np.linalg.norm(spot - other) > self.rng.uniform(0.06, 0.11) for other in taken):
                break
        return spot

    def add_clutter(self) -> None:
        rng = self.rng
        radius = rng.uniform(0.01, 0.045)
        shape = rng.choice(
            [
                mujoco.mjtGeom.mjGEOM_BOX,
                mujoco.mjtGeom.mjGEOM_CYLINDER,
                mujoco.mjtGeom.mjGEOM_SPHERE,
                mujoco.mjtGeom.mjGEOM_CAPSULE,
                mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            ]
        )
        self.world.add_geom(
            type=int(shape),
            size=radius * rng.uniform(0.4, 1.2, 3),
            pos=[*rng.normal(0, 0.19, 2), radius * rng.uniform(0.3, 1.2)],
            quat=quaternion(random_rotation(rng)),
            material=self.random_material(),
        )


def random_tint(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.75, 1, 3)


def direction(azimuth: float, elevation: float) -> np.ndarray:
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def parts_by_colour(mesh: trimesh.Trimesh) -> list[tuple[np.ndarray, np.ndarray]]:
    """Face indices and sRGB colour of each uniformly coloured part: MuJoCo has one colour a geometry."""
    colours = mesh.visual.face_colors[:, :3]
    palette, part = np.unique(colours, axis=0, return_inverse=True)
    return [(np.flatnonzero(part.ravel() == k), palette[k] / 255) for k in range(len(palette))]


def random_texture(rng: np.random.Generator) -> np.ndarray:
    """Square RGB: noise of several scales, stripes, checks or blobs between two colours."""
    size = TEXTURE_SIZE
    first, second = random_colour(rng), random_colour(rng)
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


def look_at(position: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """Rotation `camera_from_world` (OpenCV axes) of a camera that looks at `target`."""
    z = target - position
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return rotation_about_z(roll) @ np.stack([x, np.cross(z, x), z])


class SceneRenderer:
    """Renders colour and per-object masks of one scene from given cameras."""

    def __init__(self, model: mujoco.MjModel, groups: int):
        self.model, self.data, self.groups = model, mujoco.MjData(model), groups
        self.renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
        mujoco.mj_forward(model, self.data)
        self.options = mujoco.MjvOption()
        self.geom_group = np.append(model.geom_group, -1)  # index -1 is the sky

    def close(self) -> None:
        self.renderer.close()

    def set_camera(self, camera_from_world: np.ndarray, position: np.ndarray) -> None:
        self.model.cam_pos[0] = position
        self.model.cam_quat[0] = quaternion(camera_from_world.T @ OPENGL_FROM_OPENCV)
        mujoco.mj_forward(self.model, self.data)

    def colour(self) -> np.ndarray:
        self.show(range(self.groups + 1))
        return self.renderer.render()

    def visible_groups(self) -> np.ndarray:
        """`[H, W]`: the geometry group seen at each pixel."""
        self.renderer.enable_segmentation_rendering()
        self.show(range(self.groups + 1))
        visible = self.geom_group[self.renderer.render()[..., 0]]
        self.renderer.disable_segmentation_rendering()
        return visible

    def full_areas(self) -> list[int]:
        """Pixels that each object would cover if nothing stood before it."""
        self.renderer.enable_segmentation_rendering()
        areas = []
        for group in range(1, self.groups + 1):
            self.show([group])
            areas.append(int((self.renderer.render()[..., 0] >= 0).sum()))
        self.renderer.disable_segmentation_rendering()
        return areas

    def show(self, groups) -> None:
        self.options.geomgroup[:] = [int(g in groups) for g in range(6)]
        self.renderer.update_scene(self.data, camera=0, scene_option=self.options)


def random_camera(rng: np.random.Generator, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    elevation = np.radians(rng.uniform(12, 85))
    position = centre + rng.uniform(0.3, 0.88) * direction(rng.uniform(0, 2 * np.pi), elevation)
    target = centre + rng.normal(0, 0.05, 3) * [1, 1, 0.3]
    return look_at(position, target, np.radians(rng.normal(0, 15))), position


def render_scene(objects: list[ObjectMesh], scene_id: int, views: int, out: Path) -> None:
    rng = np.random.default_rng([scene_id, 7])
    builder = SceneBuilder(objects, rng)
    builder.world.add_camera(name="camera", fovy=np.degrees(2 * np.arctan(HEIGHT / 2 / FOCAL_PX)))
    renderer = SceneRenderer(builder.build(), len(objects))
    for sub in ("rgb", "mask_visib"):
        (out / sub).mkdir(parents=True, exist_ok=True)
    centre = np.mean([t[:3, 3] for t in builder.world_from_object.values()], axis=0)
    cameras, poses, infos = {}, {}, {}
    for view in range(views):
        rotation, position = random_camera(rng, centre)
        translation = -rotation @ position
        renderer.set_camera(rotation, position)
        quality = [cv2.IMWRITE_JPEG_QUALITY, 92]
        cv2.imwrite(str(out / f"rgb/{view:06d}.jpg"), cv2.cvtColor(renderer.colour(), cv2.COLOR_RGB2BGR), quality)
        visible, areas = renderer.visible_groups(), renderer.full_areas()
        poses[str(view)], infos[str(view)] = [], []
        for index, item in enumerate(objects):
            mask = (visible == index + 1).astype(np.uint8) * 255
            cv2.imwrite(str(out / f"mask_visib/{view:06d}_{index:06d}.png"), mask)
            world_from_object = builder.world_from_object[item.obj_id]
            camera_from_object = rotation @ world_from_object[:3, :3], rotation @ world_from_object[:3, 3] + translation
            poses[str(view)].append(pose_entry(item.obj_id, *camera_from_object))
            infos[str(view)].append(info_entry(mask, areas[index]))
        cameras[str(view)] = {
            "cam_K": CAMERA_MATRIX.flatten().tolist(),
            "cam_R_w2c": rotation.flatten().tolist(),
            "cam_t_w2c": (translation * 1000).tolist(),
        }
    renderer.close()
    (out / "scene_camera.json").write_text(json.dumps(cameras))
    (out / "scene_gt.json").write_text(json.dumps(poses))
    # Written last: a scene without it is unfinished and made again.
    (out / "scene_gt_info.json").write_text(json.dumps(infos))


def pose_entry(obj_id: int, rotation: np.ndarray, translation_m: np.ndarray) -> dict:
    return {
        "obj_id": obj_id,
        "cam_R_m2c": rotation.flatten().tolist(),
        "cam_t_m2c": (translation_m * 1000).tolist(),
    }


def info_entry(mask: np.ndarray, full_area: int) -> dict:
    area = int((mask > 0).sum())
    box = list(cv2.boundingRect(mask)) if area else [-1, -1, -1, -1]
    if min(box[2:]) < MIN_BOX_PX:
        box, area = [-1, -1, -1, -1], 0
    return {
        "bbox_visib": box,
        "px_count_all": full_area,
        "px_count_visib": area,
        "visib_fract": area / max(full_area, 1),
    }


def render_dataset(models_dir: Path, out: Path, scenes: int, views: int, first_scene: int = 0) -> None:
    """Renders `scenes` scenes of `views` images each; finished scenes are kept, so a stopped run goes on."""
    objects = load_objects(models_dir)
    for scene_id in tqdm(range(first_scene, first_scene + scenes), desc="scenes", unit="scene"):
        scene_dir = out / f"{scene_id:06d}"
        if not (scene_dir / "scene_gt_info.json").exists():
            render_scene(objects, scene_id, views, scene_dir)
