"""ASF/AMC: CMU's own files, a skeleton of the subject and the angles of a trial, read onto our body.

Each bone turns about axes of its own. With C the rotation of those axes and M(t) that of the angles in
the order of the degrees of freedom (the first one turns first: rx ry rz is Rz Ry Rx),

    G_bone(t) = G_parent(t) C M(t) C^T,      end = start + G_bone(t) length direction

so that all bones' frames agree with the world at zero angles, as BVH has it; `_retarget` does the rest.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Document, Format, Options, _checks
from mocap.formats._asf_text import ROTATIONS, AmcFile, AsfFile, Bone, parse_amc, parse_asf
from mocap.formats._bvh_text import euler
from mocap.formats._retarget import retarget
from mocap.formats._source import ForeignMotion, assign, needed
from mocap.motion import check_rate
from mocap.orientation import Array
from mocap.skeleton import Skeleton

RATE_HZ = 120.0  # CMU's; an AMC file names none
# CMU's "wrist" bone is the forearm's lower half: it only turns about its length. The hand bends at the
# bone "hand".
CMU_HANDS = {"lhand": "left_wrist", "rhand": "right_wrist", "lfingers": "left_hand",
             "rfingers": "right_hand"}  # fmt: skip


def read(path: Path, options: Options) -> Document:
    """The motion of an `.amc` file with the `.asf` beside it, on our body.

    The skeleton is `STEM.asf`, `SUBJECT.asf` of `SUBJECT_TRIAL.amc`, or the only one in the folder.
    options.rate_hz: default `RATE_HZ`. options.scale: m per unit (else guessed from the legs).
    options.height, options.smpl: our body. options.mapping: bone name to our joint. Raises FormatError
    naming line, frame or bone.
    """
    path = Path(path)
    if path.suffix.lower() == ".asf":
        raise FormatError(path, "is a skeleton without motion; read the .amc file beside it")
    asf_path = find_asf(path)
    asf = parse_asf(asf_path)
    rate = RATE_HZ if options.rate_hz is None else check_rate(options.rate_hz, str(path))
    amc = parse_amc(path, asf)
    source = _source(path, asf, amc, rate, options)
    body = Skeleton.default(options.height)
    if options.smpl is not None:
        body = Skeleton.from_smpl_file(options.smpl)
    done = retarget(source, body, options.scale, options.up)
    said = [assumption("skeleton-file", file=asf_path.name)]
    if amc.first > 1:
        said.append(assumption("late-start", frame=amc.first))
    if options.rate_hz is None:
        said.append(assumption("rate-of-cmu", rate_hz=RATE_HZ))
    return Document(
        "asfamc",
        done.motion,
        (*said, *done.assumed),
        (*_doubts(asf, amc.values), *done.doubts),
    )


def find_asf(path: Path) -> Path:
    """The skeleton that belongs to an `.amc` file; raises FormatError where none or several may."""
    there = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".asf")
    for stem in (path.stem, path.stem.rpartition("_")[0]):
        named = [p for p in there if p.stem.lower() == stem.lower()]
        if stem and named:
            return named[0]
    if len(there) == 1:
        return there[0]
    found = f"{len(there)} others" if there else "no other"
    prefix = path.stem.rpartition("_")[0] or path.stem
    raise FormatError(path, f"needs its skeleton {prefix}.asf in the same folder, found {found}")


def _source(path: Path, asf: AsfFile, amc: AmcFile, rate: float, options: Options) -> ForeignMotion:
    """The skeleton as joints: each sits where its bone starts; a bone without children has an end."""
    values = amc.values
    T = len(next(iter(values.values())))
    names, parents, offsets, R = [], [], [], []
    for bone in asf.bones:
        above = asf.bones[bone.parent] if bone.parent >= 0 else None
        names.append(bone.name)
        parents.append(bone.parent)
        offsets.append(above.length * above.direction if above else np.zeros(3))
        R.append(_turned(bone, values.get(bone.name), T))
    inner = {b.parent for b in asf.bones}
    for i, bone in enumerate(asf.bones):
        if i not in inner:
            names.append("")
            parents.append(i)
            offsets.append(bone.length * bone.direction)
            R.append(np.tile(np.eye(3), (T, 1, 1)))
    given = options.mapping if isinstance(options.mapping, dict) else {}
    if {"lhand", "lwrist", "lradius"} <= set(names) and not given:
        given = CMU_HANDS
    whole = ForeignMotion(
        path,
        rate,
        tuple(names),
        tuple(parents),
        np.array(offsets),
        np.stack(R, axis=1),
        {0: _path(asf.bones[0], values.get(asf.bones[0].name), T)},
        given,
        start_s=(amc.first - 1) / rate,
    )
    return whole.only(needed(whole, assign(whole)))


def _turned(bone: Bone, values: Array | None, T: int) -> Array:
    """C M C^T (T,3,3), the bone's rotation in its parent's frame."""
    order = [d for d in bone.dof if d in ROTATIONS]
    if values is None or not order:
        return np.tile(np.eye(3), (T, 1, 1))
    # The last degree of freedom is the outermost factor.
    columns = [bone.dof.index(d) for d in reversed(order)]
    M = euler("".join(d[1] for d in reversed(order)), values[:, columns])
    C = euler(bone.axis_order[::-1], bone.axis[["xyz".index(a) for a in bone.axis_order[::-1]]])
    if bone.parent < 0:
        return np.asarray(C @ M)
    return np.asarray(C @ M @ C.T)


def _path(root: Bone, values: Array | None, T: int) -> Array:
    """The root's place (T,3) in file units."""
    p = np.zeros((T, 3))
    for k, d in enumerate(root.dof):
        if values is not None and d[0] == "t":
            p[:, "xyz".index(d[1])] = values[:, k]
    return p


def _doubts(asf: AsfFile, values: dict[str, Array]) -> list[Finding]:
    still = [b.name for b in asf.bones if b.dof and b.name not in values]
    doubts = []
    if still:
        doubts.append(doubt("bones-still", bones=still))
    stretched = [b.name for b in asf.bones[1:] if set(b.dof) - set(ROTATIONS)]
    if stretched:
        doubts.append(doubt("bones-rigid", bones=stretched))
    return doubts


def sniff(path: Path, head: bytes) -> bool:
    """Whether the first bytes are those of ASF or AMC text: a comment, a keyword or a frame's number."""
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    return (start in (b"#", b":") or start.isdigit()) and b"\0" not in head


FORMAT = Format(
    "asfamc",
    (".amc", ".asf"),
    sniff,
    _checks.quiet(read),
    kinds=("motion",),
    about="CMU's files: an .amc with its subject's .asf beside it",
    sign="ASF and AMC text",
)
