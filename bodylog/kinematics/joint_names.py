"""Joints of a log and of a URDF that spell the same
name differently: kLeftElbow and left_elbow_joint.
"""

import re
from collections.abc import Iterable, Sequence

_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_EMPTY_WORDS = frozenset({"joint", "j", "k", "pos", "position", "state", "motor", "link"})
"""Words that tell nothing of a joint."""


def telling_words(name: str) -> tuple[str, ...]:
    """The telling words of a joint's name, sorted:
    ('elbow', 'left') of kLeftElbow and left_elbow_joint.
    """
    found = [word.lower() for word in _WORDS.findall(name)]
    return tuple(sorted(word for word in found if word not in _EMPTY_WORDS))


def match_joints(names: Sequence[str], known: Iterable[str]) -> dict[str, str]:
    """The known joint of each name: the same name, or else
    the only one with the same words; others are left out.
    """
    joints = list(known)
    by_words: dict[tuple[str, ...], list[str]] = {}
    for joint in joints:
        by_words.setdefault(telling_words(joint), []).append(joint)
    same_words = [telling_words(name) for name in names]
    found = {}
    for name, key in zip(names, same_words, strict=True):
        equal_words = by_words.get(key, []) if key else []
        if name in joints:
            found[name] = name
        elif len(equal_words) == 1 and same_words.count(key) == 1 and equal_words[0] not in names:
            found[name] = equal_words[0]
    return found
