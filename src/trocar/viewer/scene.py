"""The three-dimensional half of the page: arms and objects, marks, the floor, light and camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import groupby
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import trimesh
import trimesh.visual
import viser
from numpy.typing import NDArray
from trimesh.exchange.gltf import export_glb  # pyright: ignore[reportUnknownVariableType]
from trimesh.visual.material import PBRMaterial

from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.rendering.primitives import drawn_surface
from trocar.viewer.viser_hooks import move

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord, Snapshot

Floats = NDArray[np.float64]

STILL = 1e-5
"""Least change of a pose that is sent [m, and of a quaternion]: far below a pixel."""

EDGE, EDGE_MAX_M = 0.12, 0.006
"""Radius of a box's edges over its smallest half size, and its upper bound [m]. Source: by eye."""

SMOOTH = np.deg2rad(40.0)
"""Edges sharper than this are drawn sharp [rad]. Source: chosen by eye, below a right angle."""

VIEW = np.array([0.85, 1.0, 0.38])
"""From the middle of the rig towards the camera. Source: chosen by eye: across the patient."""

SKY, HORIZON = (142, 160, 180), (232, 237, 242)
"""Colours of the backdrop's upper and lower edge. Source: chosen by eye."""

ABOVE_M = 0.002
"""Height of the floor's lines above the rig's floor, so that neither hides the other [m]."""

MARGIN = 1.08
"""Distance over the one at which everything just fits a square view. Source: chosen by eye."""

SHEET = 0.6
"""Part of a phone's screen that viser's sheet covers at most. Source: viser 1.1, BottomPanel."""

WORK = np.array([0.0, 0.0, -0.25])
"""From a remote centre to the work below it [m]. Source: about the reach of an instrument."""

FIELD_OF_VIEW = np.deg2rad(38.0)
"""Vertical angle of the camera [rad]. Source: chosen by eye."""

CENTRE_RADIUS_M, CENTRE_COLOUR = 0.009, (255, 120, 20)
"""Radius and colour of the sphere that marks a remote centre [m]. Source: chosen by eye."""

ANCHORS: tuple[Literal["bottom-left", "bottom-right"], ...] = ("bottom-left", "bottom-right")
"""Labels of neighbours lean to different sides, so that they hide each other less."""

LABEL_LIFT = np.array([0.0, 0.0, 0.012])
"""From a remote centre up to its label [m]. Source: chosen by eye."""

AXES_M, AXES_RADIUS_M = 0.05, 0.0014
"""Length and radius of a tool frame's axes [m]. Source: chosen by eye."""


@lru_cache(maxsize=256)
def primitive(kind: str, size: tuple[float, ...], rounding: float = 0.0) -> trimesh.Trimesh:
    """Make the closed surface of a shape in its own frame.

    Args:
        kind: "box", "capsule", "cylinder" or "sphere"
        size: MuJoCo's sizes of that kind: half edges, (radius, half length) or radius; more numbers
            than needed are ignored [m]
        rounding: radius of a box's edges [m]; 0: `EDGE`

    Raises:
        InputError: another kind
    """
    creation, convex = cast(Any, trimesh.creation), cast(Any, trimesh.convex)  # partial types
    if kind == "box":
        half = np.array(size[:3])
        edge = rounding or min(EDGE * float(half.min()), EDGE_MAX_M)
        ball = creation.icosphere(subdivisions=2, radius=edge).vertices
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 1, 3)
        return convex.convex_hull((signs * (half - edge) + ball).reshape(-1, 3))
    if kind == "cylinder":
        return creation.cylinder(size[0], 2 * size[1], sections=32)
    if kind == "capsule":
        return creation.capsule(radius=size[0], height=2 * size[1], count=[28, 12])
    if kind == "sphere":
        return creation.icosphere(subdivisions=3, radius=size[0])
    raise InputError(f"got shape kind {kind!r}; allowed: box, capsule, cylinder, sphere")


def half_extents(kind: str, size: Sequence[float] | Floats) -> Floats:
    """Return half the size of a shape along its own axes, (3,) [m]."""
    if kind in ("box", "mesh"):
        return np.array(size[:3], dtype=np.float64)
    radius, length = float(size[0]), 0.0 if kind == "sphere" else float(size[1])
    return np.array([radius, radius, length if kind == "cylinder" else length + radius])


def parts_of(shapes: Sequence[ShapeRecord]) -> list[trimesh.Trimesh]:
    """Join the shapes of one body into one mesh per material, in the body's frame."""

    def look(shape: ShapeRecord) -> tuple[float, ...]:
        return (*shape.rgba, shape.metal, shape.gloss)

    parts: list[trimesh.Trimesh] = []
    for _, group in groupby(sorted(shapes, key=look), key=look):
        same = list(group)
        meshes = [_surface(shape) for shape in same]
        # Copies, as of a list of one, lose the normals.
        part: Any = meshes[0] if len(meshes) == 1 else cast(Any, trimesh.util).concatenate(meshes)
        part.visual = trimesh.visual.TextureVisuals(material=_material(same[0]))
        parts.append(part)
    return parts


def _surface(shape: ShapeRecord) -> trimesh.Trimesh:
    """Return a shape in its body's frame."""
    if shape.triangles is None:
        size = tuple(float(value) for value in shape.size)
        mesh = _smooth_primitive(shape.kind, size, shape.rounding).copy(include_cache=True)
    else:
        vertices, faces = shape.triangles
        mesh = trimesh.Trimesh(vertices, faces, vertex_normals=shape.normals, process=False)
        if shape.normals is None:
            mesh.unmerge_vertices()  # each triangle is drawn flat
    mesh.apply_transform(shape.pose)  # pyright: ignore[reportUnknownMemberType]
    return mesh


@lru_cache(maxsize=256)
def _smooth_primitive(kind: str, size: tuple[float, ...], rounding: float) -> trimesh.Trimesh:
    return cast(Any, trimesh.graph).smooth_shade(primitive(kind, size, rounding), angle=SMOOTH)


def _material(shape: ShapeRecord) -> PBRMaterial:
    """Return the material of a shape; the descriptions' gloss is smoothness."""
    srgb = np.array(shape.rgba[:3])
    # glTF has linear light. Source: IEC 61966-2-1.
    light = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return PBRMaterial(
        baseColorFactor=(*light, shape.rgba[3]),
        metallicFactor=shape.metal,
        roughnessFactor=1.0 - shape.gloss,
        alphaMode="BLEND" if shape.rgba[3] < 1.0 else None,
    )


def glb(parts: Sequence[trimesh.Trimesh]) -> bytes:
    """Return meshes as binary glTF, with normals."""
    return export_glb(trimesh.Scene(parts), include_normals=True)


def body_names(shapes: Sequence[ShapeRecord]) -> dict[int, str]:
    """Return {body: its name in MuJoCo}, as "PSM1/wrist_yaw" and "table"; rods have numbers."""
    names = {
        shape.body: f"{shape.arm}/{shape.frame}" if shape.arm else shape.name.rpartition("/")[0]
        for shape in shapes
    }
    counts = Counter(names.values())
    whole = {shape.body: shape.name for shape in shapes}
    return {body: whole[body] if counts[name] > 1 else name for body, name in names.items()}


def node_of(name: str) -> str:
    """Return the scene's node of a body."""
    return f"/world/{name}"


def drawing_node(name: str) -> str:
    """Return the scene's node of a drawing."""
    return f"/world/drawings/{name}"


class Bodies:
    """One node per body; only those that moved are sent.

    Attributes:
        glbs: {body: its look, as binary glTF}
    """

    def __init__(self, scene: viser.SceneApi, shapes: Iterable[ShapeRecord]) -> None:
        self._scene = scene
        self.glbs: dict[int, bytes] = {}
        self._names: dict[int, str] = {}
        self._nodes: dict[int, viser.GlbHandle] = {}
        self.renew(shapes)

    def renew(self, shapes: Iterable[ShapeRecord]) -> int:
        """Show other shapes, as after a tool exchange; return the number of new bodies."""
        by_body = sorted(shapes, key=lambda shape: shape.body)
        glbs = {
            body: glb(parts_of(tuple(group)))
            for body, group in groupby(by_body, key=lambda shape: shape.body)
        }
        names = body_names(by_body)
        for body in [
            b for b, g in self.glbs.items() if (glbs.get(b), names.get(b)) != (g, self._names[b])
        ]:
            self._nodes.pop(body).remove()
        fresh = [body for body in glbs if body not in self._nodes]
        for body in fresh:
            self._nodes[body] = self._scene.add_glb(node_of(names[body]), glbs[body])
        self.glbs, self._names = glbs, names
        self._index = np.array(list(self._nodes), dtype=int)
        self._sent = np.full((len(self._index), 7), np.inf)
        return len(fresh)

    def show(self, snapshot: Snapshot) -> int:
        """Send the poses that changed; return their number."""
        positions, quaternions = snapshot.positions, snapshot.quaternions
        poses = np.concatenate([positions[self._index], quaternions[self._index]], axis=1)
        moved = np.any(np.abs(poses - self._sent) > STILL, axis=1)
        move(self._scene, [self._nodes[body] for body in self._index[moved].tolist()], poses[moved])
        self._sent[moved] = poses[moved]
        return int(np.count_nonzero(moved))


class Drawings:
    """One node per surface or curve that bends; only those that moved are sent.

    Attributes:
        nodes: {drawing: its mesh}
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self.nodes: dict[str, viser.MeshHandle] = {}

    def show(self, snapshot: Snapshot) -> int:
        """Send the drawings that changed and remove those that are gone; return the number sent."""
        sent = 0
        for name in self.nodes.keys() - {drawing.name for drawing in snapshot.drawings}:
            self.nodes.pop(name).remove()
        for drawing in snapshot.drawings:
            found, node = drawn_surface(drawing), self.nodes.get(drawing.name)
            points, faces = found.points.astype(np.float32), found.faces.astype(np.uint32)
            if node is None or not np.array_equal(node.faces, faces):
                self.nodes[drawing.name] = self._scene.add_mesh_simple(
                    drawing_node(drawing.name), points, faces, color=drawing.rgba[:3]
                )
            elif np.abs(node.vertices - points).max() > STILL:
                node.vertices = points
            else:
                continue
            sent += 1
        return sent


class RemoteCentres:
    """A small sphere with the arm's name at each remote centre.

    Attributes:
        visible: whether they are shown
    """

    def __init__(self, scene: viser.SceneApi, snapshot: Snapshot) -> None:
        self.visible = True
        names = [name for name, arm in snapshot.arms.items() if arm.remote_centre is not None]
        self._nodes = {
            name: (
                scene.add_icosphere(
                    f"/marks/centre_{name}",
                    radius=CENTRE_RADIUS_M,
                    color=CENTRE_COLOUR,
                    subdivisions=3,
                    cast_shadow=False,
                    receive_shadow=False,
                ),
                scene.add_label(
                    f"/marks/label_{name}", name, anchor=ANCHORS[k % 2], font_screen_scale=0.75
                ),
            )
            for k, name in enumerate(names)
        }
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Move the marks to the centres."""
        for name, (sphere, label) in self._nodes.items():
            centre = snapshot.arms[name].remote_centre
            if centre is not None:
                sphere.position, label.position = centre, centre + LABEL_LIFT

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of them."""
        self.visible = visible
        for nodes in self._nodes.values():
            for node in nodes:
                node.visible = visible


class ToolFrames:
    """Three axes at the tip of each arm: x red, y green, z blue.

    Attributes:
        visible: whether they are shown
        nodes: {arm: its axes}
    """

    def __init__(self, scene: viser.SceneApi, arms: Iterable[str]) -> None:
        self.visible = False
        self.nodes = {
            name: scene.add_frame(
                f"/marks/tip_{name}", axes_length=AXES_M, axes_radius=AXES_RADIUS_M, visible=False
            )
            for name in arms
        }

    def show(self, tips: Mapping[str, Floats]) -> None:
        """Move the axes to the tips: {arm: T_world_tip (4, 4)}."""
        for name, tip in tips.items():
            node = self.nodes[name]
            node.position, node.wxyz = tip[:3, 3], quaternion_from_matrix(tip[:3, :3])

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of them."""
        self.visible = visible
        for node in self.nodes.values():
            node.visible = visible


def tips_of(world: World) -> dict[str, Floats]:
    """Return the tip of every arm in the world, T_world_tip (4, 4); call it through `Loop.ask`."""
    return {
        name: world.reference_pose(name) @ arm.local.measured_cp().matrix
        for name, arm in world.arms.items()
        if arm.description.type in ("PSM", "ECM", "MTM")
    }


def stage(server: viser.ViserServer, shapes: Sequence[ShapeRecord], snapshot: Snapshot) -> None:
    """Add backdrop and floor, and point the camera of every new browser; `Drawing` adds light.

    The backdrop grows darker upwards, so that the white arms stand out; the floor, on which the rig
    stands, has lines every 10 cm and every metre.
    The camera has all arms in sight, and the work below their remote centres.
    """
    scene = server.scene
    floors = [shape for shape in shapes if shape.name.startswith("floor")]
    heights = corners(floors or shapes, snapshot)[:, 2]
    floor = float(heights.max() if floors else heights.min()) + ABOVE_M
    scene.configure_default_lights(enabled=False)
    rise = np.linspace(0.0, 1.0, 256)[:, None, None]
    colours = (1 - rise) * np.array(SKY) + rise * np.array(HORIZON)
    scene.set_background_image(np.repeat(colours, 8, axis=1).astype(np.uint8), format="png")
    scene.add_grid(
        "/floor",
        width=12.0,
        height=12.0,
        cell_size=0.1,
        section_size=1.0,
        cell_color=(206, 211, 217),
        section_color=(176, 183, 192),
        cell_thickness=0.6,
        section_thickness=1.0,
        plane_color=(222, 227, 232),
        plane_opacity=1.0,
        shadow_opacity=0.35,
        fade_distance=9.0,
        fade_strength=1.6,
        fade_from="origin",
        position=(0.0, 0.0, floor),
    )
    arms = corners([shape for shape in shapes if shape.arm] or shapes, snapshot)
    centres = (arm.remote_centre for arm in snapshot.arms.values())
    work = [centre + WORK for centre in centres if centre is not None]
    camera = server.initial_camera
    camera.fov = FIELD_OF_VIEW
    camera.position, camera.look_at = camera_for(np.array([*arms, *work]), VIEW)
    camera.near, camera.far = 0.02, 60.0


def camera_for(points: Floats, view: Floats) -> tuple[Floats, Floats]:
    """Place the nearest camera that has points in a square view.

    Args:
        points: (n, 3) [m]
        view: direction from the points to the camera, (3,)

    Returns:
        position, and the point that it looks at, (3,) each [m]
    """
    forward = -view / np.linalg.norm(view)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(right, forward), forward])
    across, ahead = (points @ R.T)[:, :2], (points @ R.T)[:, 2:]
    # A camera at (x, y) and depth -d sees a point where |p_xy - xy| <= tan(fov / 2) (p_z + d).
    t = np.tan(FIELD_OF_VIEW / 2)
    high, low = (across / t - ahead).max(axis=0), (-across / t - ahead).max(axis=0)
    xy, depth = t * (high - low) / 2, MARGIN * float((high + low).max()) / 2
    middle = float(ahead.min() + ahead.max()) / 2
    return R.T @ [*xy, -depth], R.T @ [*xy, middle]


def camera_above_sheet(position: Floats, look_at: Floats, aspect: float) -> tuple[Floats, Floats]:
    """Move a camera of a square view back and down, for a tall view with a sheet over `SHEET`.

    Args:
        position, look_at: of the camera, (3,) each [m]
        aspect: width over height of the tall view, below 1

    Returns:
        position, and the point that it looks at, (3,) each [m]
    """
    forward = look_at - position
    right = np.cross(forward, (0.0, 0.0, 1.0))
    up = np.cross(right, forward)
    up /= np.linalg.norm(up)
    back = forward / min(aspect, 1.0 - SHEET)
    down = -up * SHEET * np.linalg.norm(back) * np.tan(FIELD_OF_VIEW / 2)
    return look_at - back + down, look_at + down


def corners(shapes: Sequence[ShapeRecord], snapshot: Snapshot) -> Floats:
    """Return the corners of the boxes around shapes, in the world, (n, 3) [m]."""
    bodies = [shape.body for shape in shapes]
    R = matrix_from_quaternion(snapshot.quaternions[bodies])
    poses = np.array([shape.pose for shape in shapes])
    halves = np.array([half_extents(shape.kind, shape.size) for shape in shapes])
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    local = poses[:, None, :3, 3] + np.einsum(
        "nij,nkj->nki", poses[:, :3, :3], halves[:, None] * signs
    )
    placed = snapshot.positions[bodies][:, None] + np.einsum("nij,nkj->nki", R, local)
    return placed.reshape(-1, 3)
