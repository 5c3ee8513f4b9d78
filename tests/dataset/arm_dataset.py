"""A drawn arm of three textured links before a textured wall, as LeRobot episodes: without
bodylog's code."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from tests.logs.datasets import drawn

FPS = 20
SIZE = (160, 120)
"""Width and height of the images, px."""
SECONDS = 9.0
NAMES = ("pan", "lift", "wrist")
LENGTHS_PX = (34, 28, 20)
HOME = np.array([0.4, 1.1, -0.7])
DELAY_S = 0.06
"""Delay of the images' stamps against the joints."""
LEAD_S = 0.1
"""Time by which actions lead the joints."""
NOISE_RAD = 0.0005


@dataclass(frozen=True)
class Episode:
    """What is stored: state, action (N,3) rad, images (N,H,W,3)."""

    state: np.ndarray
    action: np.ndarray
    images: np.ndarray = field(repr=False)


def motion(seed: int) -> Callable[[np.ndarray], np.ndarray]:
    """Joint angles (N,3) rad at times (N,) s: sums of sines that begin at home."""
    rng = np.random.default_rng(seed)
    rates = rng.uniform(0.15, 0.8, (4, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, (4, 3))
    sizes = rng.uniform(0.1, 0.25, (4, 3))

    def angles(t: np.ndarray) -> np.ndarray:
        ease = np.clip(t / 0.6, 0.0, 1.0)[:, None] ** 2
        waves = sizes * np.sin(2.0 * np.pi * rates * t[:, None, None] + phases)
        return HOME + ease * waves.sum(axis=1)

    return angles


def draw(angles: np.ndarray, wall: np.ndarray, links: list[np.ndarray]) -> np.ndarray:
    """The arm at `angles` (3,) rad before the wall."""
    picture = wall.copy()
    turn, place = 0.0, np.array([80.0, 112.0])
    for length, angle, link in zip(LENGTHS_PX, angles, links, strict=True):
        turn += angle
        along = np.array([np.sin(turn), -np.cos(turn)])
        across = np.array([along[1], -along[0]])
        height, width = link.shape[:2]
        matrix = np.column_stack(
            [along * length / width, across * 12.0 / height, place - 6.0 * across]
        )
        warped = cv2.warpAffine(link, matrix, SIZE, flags=cv2.INTER_LINEAR)
        mask = cv2.warpAffine(np.full(link.shape[:2], 255, np.uint8), matrix, SIZE)
        picture[mask > 127] = warped[mask > 127]
        place = place + along * length
    return picture


def texture(rng: np.random.Generator, width: int, height: int, blur_px: float) -> np.ndarray:
    """Smoothed noise (H,W,3) uint8."""
    noise = cv2.GaussianBlur(
        rng.normal(0.0, 1.0, (height, width, 3)).astype(np.float32), (0, 0), blur_px
    )
    return np.clip(120.0 + 55.0 * noise / noise.std(), 0, 255).astype(np.uint8)


def episode(seed: int, delay_s: float = DELAY_S, wall_seed: int = 0) -> Episode:
    """A sound episode; the world is that of `wall_seed`, the motion that of `seed`."""
    angles = motion(seed)
    rng = np.random.default_rng(1000 + seed)
    t = np.arange(int(SECONDS * FPS)) / FPS
    world = np.random.default_rng(wall_seed)
    wall = texture(world, *SIZE, 2.5)
    links = [texture(world, 48, 16, 1.5) for _ in LENGTHS_PX]
    jitter = rng.normal(0.0, 0.003)
    shown = angles(t - delay_s - jitter)
    pictures = np.array([draw(q, wall, links) for q in shown])
    noise = rng.normal(0.0, 2.0, (*pictures.shape[:3], 1))
    pictures = np.clip(pictures + noise, 0, 255).astype(np.uint8)
    state = angles(t) + rng.normal(0.0, NOISE_RAD, (len(t), 3))
    return Episode(state, angles(t + LEAD_S), pictures)


def late_camera(one: Episode, seed: int) -> Episode:
    """The same motion, filmed 0.2 s later."""
    return replace(one, images=episode(seed, DELAY_S + 0.2).images)


def repeated_frames(one: Episode, _seed: int) -> Episode:
    """Every second frame repeats the one before."""
    images = one.images.copy()
    images[1::2] = images[0::2][: len(images[1::2])]
    return replace(one, images=images)


def frozen_joint(one: Episode, _seed: int) -> Episode:
    """The second joint's encoder repeats a reading for three seconds."""
    state = one.state.copy()
    state[70:130, 1] = state[70, 1]
    return replace(one, state=state)


def clipped_joint(one: Episode, _seed: int) -> Episode:
    """The third joint's reading does not pass its 70 % quantile."""
    state = one.state.copy()
    state[:, 2] = np.minimum(state[:, 2], np.quantile(state[:, 2], 0.7))
    return replace(one, state=state)


def wrong_unit(one: Episode, _seed: int) -> Episode:
    """Degrees among radians."""
    return replace(one, state=np.rad2deg(one.state), action=np.rad2deg(one.action))


def swapped_joints(one: Episode, _seed: int) -> Episode:
    """The second and third joint change places."""
    return replace(one, state=one.state[:, [0, 2, 1]], action=one.action[:, [0, 2, 1]])


def black_camera(one: Episode, _seed: int) -> Episode:
    """The camera is covered."""
    return replace(one, images=np.full_like(one.images, 4))


def frozen_camera(one: Episode, _seed: int) -> Episode:
    """The camera repeats a picture for two seconds."""
    images = one.images.copy()
    images[60:100] = images[60]
    return replace(one, images=images)


FAULTS: dict[str, tuple[Callable[[Episode, int], Episode], str]] = {
    "late camera": (late_camera, "delay/top"),
    "repeated frames": (repeated_frames, "repeated/top"),
    "frozen joint": (frozen_joint, "longest_repeat/lift"),
    "clipped joint": (clipped_joint, "clipped/wrist"),
    "wrong unit": (wrong_unit, "size/lift"),
    "swapped joints": (swapped_joints, "start/lift"),
    "black camera": (black_camera, "black/top"),
    "frozen camera": (frozen_camera, "frozen/top"),
}
"""What is done to one episode, and a figure by which it stands out."""


def write(folder: Path, episodes: list[Episode], write_film: bool = True) -> Path:
    """A LeRobot v2.1 folder of the episodes, with or without their videos."""
    lengths = [len(one.state) for one in episodes]
    features = {
        name: {"dtype": "float32", "shape": [3], "names": list(NAMES)}
        for name in ("observation.state", "action")
    }
    features |= {
        drawn.CAMERA: {
            "dtype": "video",
            "shape": [SIZE[1], SIZE[0], 3],
            "names": ["height", "width", "channels"],
        },
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        **{
            name: {"dtype": "int64", "shape": [1], "names": None}
            for name in ("frame_index", "episode_index")
        },
    }
    drawn.info(folder, "v2.1", lengths, features=features, fps=FPS)
    for number, one in enumerate(episodes):
        write_episode(folder, number, one, write_film)
    listed = [
        {"episode_index": number, "tasks": ["reach"], "length": rows}
        for number, rows in enumerate(lengths)
    ]
    (folder / "meta/episodes.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in listed))
    (folder / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "reach"}\n')
    return folder


def write_episode(folder: Path, number: int, one: Episode, write_film: bool = True) -> None:
    """The table and the video of an episode."""
    rows = len(one.state)
    columns = {
        "observation.state": one.state.astype(np.float32), "action": one.action.astype(np.float32),
        "timestamp": (np.arange(rows) / FPS).astype(np.float32), "frame_index": np.arange(rows),
        "episode_index": np.full(rows, number),
    }  # fmt: skip
    drawn.table(folder / f"data/chunk-000/episode_{number:06d}.parquet", columns)
    if not write_film:
        return
    film = folder / f"videos/chunk-000/{drawn.CAMERA}/episode_{number:06d}.mp4"
    drawn.film(film, one.images, crf="18", preset="ultrafast")
