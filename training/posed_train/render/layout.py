"""What stands where in a scene, and where the cameras are. World frame: metres, z up, table top at z = 0."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from .objects import ObjectMesh

WIDTH, HEIGHT, FOCAL_PX = 640, 480, 600.0
CAMERA_MATRIX = np.array([[FOCAL_PX, 0, (WIDTH - 1) / 2], [0, FOCAL_PX, (HEIGHT - 1) / 2], [0, 0, 1]])
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
CLUTTER_SHAPES = ("box", "cylinder", "ellipsoid", "capsule")
MIN_OBJECTS_IN_VIEW = 0.75
SPREAD_M = 0.055
"""Standard deviation of an object's place on the table, for one object: they share the more room the more they are."""


@dataclass(frozen=True)
class Camera:
    camera_from_world: np.ndarray  # [4, 4], OpenCV axes

    @property
    def position(self) -> np.ndarray:
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    @property
    def world_from_opengl(self) -> np.ndarray:
        """`[4, 4]`: the pose of a camera that looks along -z with y up, as MuJoCo and Blender have it."""
        pose = np.linalg.inv(self.camera_from_world)
        pose[:3, :3] = pose[:3, :3] @ OPENGL_FROM_OPENCV
        return pose


@dataclass(frozen=True)
class Light:
    position: np.ndarray  # [3]; shines at the origin
    tint: np.ndarray  # [3], 0..1


@dataclass(frozen=True)
class Clutter:
    shape: str  # one of CLUTTER_SHAPES
    half_size: np.ndarray  # [3]
    world_from_clutter: np.ndarray  # [4, 4]


@dataclass(frozen=True)
class Wall:
    position: np.ndarray  # [3]
    azimuth: float  # of the direction away from the table


@dataclass(frozen=True)
class Layout:
    world_from_object: list[np.ndarray]  # [4, 4], in the order of the objects
    table_half_m: float
    floor_z: float
    walls: list[Wall]
    lights: list[Light]
    clutter: list[Clutter]
    cameras: list[Camera]
    first_moves: list[np.ndarray] = field(default_factory=list)  # [4, 4] of the first object, for each camera

    def poses(self, view: int) -> list[np.ndarray]:
        """`world_from_object` of all objects while a camera looks."""
        return [self.first_moves[view], *self.world_from_object[1:]] if self.first_moves else self.world_from_object


@dataclass(frozen=True)
class Camouflage:
    """Gives things around the objects a colour of one of them, which hides its outline."""

    objects: list[ObjectMesh]
    share: float  # of the things

    def colour(self, rng: np.random.Generator) -> np.ndarray | None:
        """`[3]` sRGB, 0..1, as new or faded; none for things that are not to look alike."""
        if not self.share or rng.random() >= self.share:
            return None
        parts = self.objects[rng.integers(len(self.objects))].parts
        worn = rng.uniform(0.5, 1.3) * rng.uniform(0.9, 1.1, 3)
        return np.clip(parts[rng.integers(len(parts))].colour * worn, 0, 1)


def draw_layout(objects: list[ObjectMesh], views: int, tumbled: float, rng: np.random.Generator) -> Layout:
    """`tumbled` is the share of objects that stand at random instead of lying on one of their sides."""
    placed: list[np.ndarray] = []
    spread = SPREAD_M * np.sqrt(len(objects))
    for item in objects:
        placed.append(place(item, placed, spread, tumbled, rng))
    centre = np.mean([pose[:3, 3] for pose in placed], axis=0)
    return Layout(
        world_from_object=placed,
        table_half_m=rng.uniform(0.6, 3),
        floor_z=-rng.uniform(0.05, 0.9),
        walls=[draw_wall(quarter, rng) for quarter in range(4)],
        lights=[draw_light(rng) for _ in range(rng.integers(1, 4))],
        clutter=[draw_clutter(placed, rng) for _ in range(rng.integers(4, 14))],
        cameras=[draw_camera(objects, placed, centre, rng) for _ in range(views)],
    )


def place(
    item: ObjectMesh, others: list[np.ndarray], spread: float, tumbled: float, rng: np.random.Generator
) -> np.ndarray:
    """`world_from_object` of an object on the table, some way from the others (they may still touch)."""
    pose = np.eye(4)
    if rng.random() < tumbled:
        pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    else:
        resting = rng.choice(len(item.resting_rotations), p=item.resting_probabilities)
        pose[:3, :3] = about_z(rng.uniform(0, 2 * np.pi)) @ item.resting_rotations[resting]
    spot = free_spot(others, spread, apart=(0.06, 0.11), rng=rng)
    lowest = (item.mesh.vertices @ pose[:3, :3].T)[:, 2].min()
    pose[:3, 3] = [*spot, -lowest + 0.0003]
    return pose


def free_spot(
    others: list[np.ndarray], spread: float, apart: tuple[float, float], rng: np.random.Generator
) -> np.ndarray:
    """A place on the table `[2]` that far from all others, if fifty draws find one."""
    for _ in range(50):
        spot = rng.normal(0, spread, 2)
        if all(np.linalg.norm(spot - other[:2, 3]) > rng.uniform(*apart) for other in others):
            break
    return spot


def draw_wall(quarter: int, rng: np.random.Generator) -> Wall:
    azimuth = quarter * np.pi / 2 + rng.uniform(-0.3, 0.3)
    return Wall(rng.uniform(1.5, 4) * direction(azimuth, 0), azimuth)


def draw_light(rng: np.random.Generator) -> Light:
    towards = direction(rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.5))
    return Light(rng.uniform(0.9, 2.4) * towards, random_tint(rng))


def draw_clutter(objects: list[np.ndarray], rng: np.random.Generator) -> Clutter:
    radius = rng.uniform(0.01, 0.045)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    spot = free_spot(objects, spread=0.19, apart=(0.03 + radius, 0.06 + radius), rng=rng)
    pose[:3, 3] = [*spot, radius * rng.uniform(0.3, 1.2)]
    return Clutter(str(rng.choice(CLUTTER_SHAPES)), radius * rng.uniform(0.4, 1.2, 3), pose)


def draw_camera(
    objects: list[ObjectMesh], placed: list[np.ndarray], centre: np.ndarray, rng: np.random.Generator
) -> Camera:
    """A camera that sees most of the objects whole, if a hundred draws find one."""
    for _ in range(100):
        position = centre + rng.uniform(0.3, 0.88) * direction(
            rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(12, 85))
        )
        target = centre + rng.normal(0, 0.05, 3) * [1, 1, 0.3]
        camera = Camera(look_at(position, target, np.radians(rng.normal(0, 14))))
        in_view = sum(is_in_view(item, pose, camera) for item, pose in zip(objects, placed))
        if in_view >= MIN_OBJECTS_IN_VIEW * len(objects):
            break
    return camera


def is_in_view(item: ObjectMesh, world_from_object: np.ndarray, camera: Camera) -> bool:
    camera_from_object = camera.camera_from_world @ world_from_object
    in_camera = item.mesh.vertices @ camera_from_object[:3, :3].T + camera_from_object[:3, 3]
    pixels = in_camera @ CAMERA_MATRIX.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    return bool((pixels > 0).all() and (pixels < [WIDTH, HEIGHT]).all() and (in_camera[:, 2] > 0).all())


def look_at(position: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """`camera_from_world` of a camera that looks at `target`."""
    z = target - position
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = about_z(roll) @ np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ position
    return pose


def about_z(angle: float) -> np.ndarray:
    return Rotation.from_euler("z", angle).as_matrix()


def direction(azimuth: float, elevation: float) -> np.ndarray:
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def random_tint(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.75, 1, 3)


def random_colour(rng: np.random.Generator) -> np.ndarray:
    colour = rng.uniform(0, 1, 3)
    return np.full(3, colour.mean()) if rng.random() < 0.4 else colour
