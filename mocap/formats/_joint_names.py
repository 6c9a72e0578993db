"""Which joint of a foreign skeleton is which of ours, by name.

A name is cut into words ("mixamorig:LeftUpLeg": mixamorig, Left, Up, Leg). Words that most names share at
their front or back belong to the tool or the actor and are dropped; a word for a side may stand anywhere;
what is left, joined, is the stem. Tools disagree about stems ("LeftShoulder" is a collar bone to Mixamo
and an upper arm to Xsens), so a stem that two of our joints could have goes to the one that no clearer
name claims. The pelvis and the spine are found by structure, not here.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence

from mocap.skeleton import JOINTS

# For one side, clearest name first; the joints claim in this order.
_LIMBS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("hip", ("upleg", "upperleg", "uleg", "thigh", "thighbend", "femur", "hip")),
    ("knee", ("knee", "lowerleg", "lowleg", "lleg", "shin", "shank", "calf", "tibia", "leg")),
    ("ankle", ("ankle", "foot")),
    ("foot", ("toebase", "toe", "toes", "toe0", "ball", "foot")),
    ("shoulder", ("upperarm", "uparm", "uarm", "humerus", "shldr", "shldrbend", "arm", "shoulder")),
    ("collar", ("collar", "clavicle", "clav", "shoulder")),
    ("elbow", ("elbow", "forearm", "forearmbend", "farm", "lowerarm", "lowarm", "larm", "radius")),
    ("wrist", ("wrist", "hand")),
    ("hand", ("handmiddle1", "middle1", "mid1", "fmiddle01", "middleproximal", "fingers",
              "fingerbase", "handindex1", "index1", "indexproximal", "hand")),
)  # fmt: skip
_CENTRE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("neck", ("neck", "neck1", "lowerneck", "upperneck", "necktwist01")),
    ("head", ("head",)),
)
# MikuMikuDance's standard bones, whose names are Japanese, by their NFKC form.
_JAPANESE: dict[str, str] = {
    "足": "upleg", "ひざ": "knee", "膝": "knee", "足首": "ankle", "つま先": "toe", "肩": "collar",
    "腕": "upperarm", "ひじ": "elbow", "肘": "elbow", "手首": "wrist", "中指1": "middle1",
    "人指1": "index1", "首": "neck", "頭": "head",
}  # fmt: skip
REQUIRED = tuple(f"{s}_{j}" for j in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
                 for s in ("left", "right"))  # fmt: skip
_STEMS = frozenset(stem for _, stems in (*_LIMBS, *_CENTRE) for stem in stems)
_SIDES = {"left": "left", "right": "right", "l": "left", "r": "right", "左": "left", "右": "right"}
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+|[^\W\d_a-zA-Z]+")
_SEPARATORS = re.compile(r"[\W_]+")
SHARED = 0.5  # of the names; a word that so many begin or end with tells no joint
SHOWN = 400  # characters of names in a message


def _words(name: str) -> list[str]:
    """Lower-case words of a name; runs of capitals and digits are words, Japanese ones stay whole."""
    flat = unicodedata.normalize("NFKC", name.strip())
    words = [w for part in _SEPARATORS.split(flat) for w in _WORD.findall(part)]
    if words and words[0][0] in "左右" and len(words[0]) > 1:
        words[:1] = [words[0][0], words[0][1:]]
    return [w.lower() for w in words]


def _without_shared(names: Sequence[list[str]]) -> list[list[str]]:
    """The words of each name without those that most names share at the front or the back.

    A word that is a joint's or a side's stays: most names of a hand with fingers begin with "hand".
    """
    out = [list(words) for words in names]
    for end in (0, -1):
        while True:
            count = Counter(w[end] for w in out if len(w) > 1)
            word, times = count.most_common(1)[0] if count else ("", 0)
            # Numbers at the back count bones; at the front they are an actor's.
            kept = word in _STEMS or word in _SIDES or (word.isdigit() and end == -1)
            if kept or times < max(2.0, SHARED * len(out)):
                break
            for words in out:
                if len(words) > 1 and words[end] == word:
                    del words[end]
    return out


def _split(words: Sequence[str]) -> tuple[str, str]:
    """`("left" | "right" | "", stem)` of a name's words."""
    if len(words) > 1 and words[0] in ("c", "center", "centre"):
        return "", _stem("".join(words[1:]))
    at = [k for k, w in enumerate(words) if w in _SIDES]
    # A whole word for a side counts before a letter: "l" may be an initial.
    at.sort(key=lambda k: len(words[k]) == 1 and words[k] in "lr")
    if at:
        rest = [w for k, w in enumerate(words) if k != at[0]]
        return _SIDES[words[at[0]]], _stem("".join(rest))
    flat = "".join(words)
    for word in ("left", "right"):
        if flat.startswith(word):
            return word, _stem(flat.removeprefix(word))
        if flat.endswith(word):
            return word, _stem(flat.removesuffix(word))
    for letter in "lr":
        if flat.startswith(letter) and _stem(flat[1:]) in _STEMS:
            return _SIDES[letter], _stem(flat[1:])
        if flat.endswith(letter) and _stem(flat[:-1]) in _STEMS:
            return _SIDES[letter], _stem(flat[:-1])
    return "", _stem(flat)


def _stem(flat: str) -> str:
    """A stem in our spelling: Japanese ones translated, the number of a first bone dropped."""
    flat = _JAPANESE.get(flat, flat)
    if flat in _STEMS:
        return flat
    bare = re.sub(r"0*[01]$", "", flat)
    return bare if bare in _STEMS else flat


def match(names: Sequence[str], given: Mapping[str, str] | None = None) -> dict[str, int]:
    """Index of the source joint for each of our joints whose name was recognised.

    names: the source's joint names, "" for those that cannot be matched; of several that are alike the
    first counts. given: source name to our name, which overrides.
    """
    ours: dict[str, int] = {}
    for source, joint in (given or {}).items():
        if source in names and joint in JOINTS:
            ours[joint] = names.index(source)
    at = [i for i, name in enumerate(names) if _words(name)]
    by_name: dict[tuple[str, str], int] = {}
    for i, words in zip(at, _without_shared([_words(names[i]) for i in at]), strict=True):
        by_name.setdefault(_split(words), i)
    wanted = [(f"{side}_{j}", (side, s)) for side in ("left", "right") for j, s in _LIMBS]
    wanted += [(j, ("", s)) for j, s in _CENTRE]
    for joint, (side, stems) in wanted:
        for stem in stems:
            found = by_name.get((side, stem))
            if joint not in ours and found is not None and found not in ours.values():
                ours[joint] = found
    return ours


def unmatched(names: Sequence[str], ours: Mapping[str, int]) -> str:
    """What to tell where a required joint was not recognised: names there are, the option to write."""
    line = ",".join(f"NAME={j}" for j in REQUIRED if j not in ours)
    free = ", ".join(n for i, n in enumerate(names) if n and i not in ours.values())
    shown = free if len(free) <= SHOWN else f"{free[:SHOWN]}..."
    return (
        f"limbs were not recognised by their names: complete --map '{line}' with the file's own, which are "
        f"{shown or 'all taken'}"
    )
