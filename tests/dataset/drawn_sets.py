"""Drawn datasets: each world has its own arm, clutter, cameras and recorder; without bodylog's
code."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from tests.logs.datasets import drawn

FPS = drawn.FPS
SIZE = (160, 120)
"""Width and height of the images, px."""
WORDS = ("pan", "lift", "elbow", "wrist", "roll")
LEAST_JOINTS = 3


@dataclass(frozen=True, eq=False)
class World:
    """What all episodes of a dataset share.

    lengths (K,) px of links · home (K,) rad · base (2,) px · links: their textures · wall (H,W,3) ·
    things: textures that lie elsewhere in each episode · delay_s, lead_s · noise_rad, and step_rad
    of the encoders (0: none) · stored_twice: the camera has half the rate · reaches: whether the
    arm is still between motions · cameras: their names.
    """

    seed: int
    lengths: np.ndarray
    home: np.ndarray
    base: np.ndarray
    links: list[np.ndarray]
    walls: list[np.ndarray]
    things: list[np.ndarray]
    delay_s: float
    lead_s: float
    noise_rad: float
    step_rad: float
    stored_twice: bool
    reaches: bool
    cameras: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return WORDS[: len(self.home)]


@dataclass(frozen=True)
class Episode:
    """What is stored: state, action (N,K) rad, images {camera: (N,H,W,3)}."""

    state: np.ndarray
    action: np.ndarray
    images: dict[str, np.ndarray] = field(repr=False)


def draw_texture(rng: np.random.Generator, width: int, height: int, blur_px: float) -> np.ndarray:
    """Smoothed noise about a colour (H,W,3) uint8."""
    noise = rng.normal(0.0, 1.0, (height, width, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), blur_px)
    colour = rng.uniform(70.0, 170.0, 3)
    contrast = rng.uniform(25.0, 50.0)
    return np.clip(colour + contrast * smooth / smooth.std(), 0, 255).astype(np.uint8)


def draw_world(seed: int) -> World:
    """A world by its seed."""
    rng = np.random.default_rng([seed, 1])
    count = int(rng.integers(LEAST_JOINTS, len(WORDS) + 1))
    weights = rng.uniform(0.8, 1.2, count) * np.linspace(1.3, 0.7, count)
    turns = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.9, count) * (-1.0) ** np.arange(count)
    cameras = ("top", "side") if rng.random() < 0.25 else ("top",)
    return World(
        seed=seed,
        lengths=95.0 * weights / weights.sum(),
        home=turns,
        base=np.array([rng.uniform(60.0, 100.0), rng.uniform(108.0, 118.0)]),
        links=[draw_texture(rng, 48, 16, rng.uniform(1.2, 2.0)) for _ in range(count)],
        walls=[draw_texture(rng, *SIZE, rng.uniform(1.5, 4.0)) for _ in cameras],
        things=[draw_texture(rng, 18, 18, 1.5) for _ in range(int(rng.integers(0, 4)))],
        delay_s=rng.uniform(0.0, 0.12),
        lead_s=rng.uniform(0.05, 0.2),
        noise_rad=rng.uniform(0.0002, 0.002),
        step_rad=float(rng.choice([0.0, 2.0 * np.pi / 4096.0])),
        stored_twice=bool(rng.random() < 0.25),
        reaches=bool(rng.random() < 0.5),
        cameras=cameras,
    )


def draw_motion(world: World, number: int, seconds: float) -> Callable[[np.ndarray], np.ndarray]:
    """Joint angles (N,K) rad at times (N,) s, from near home: sines, or reaches with is still."""
    rng = np.random.default_rng([world.seed, 2, number])
    count = len(world.home)
    start = world.home + rng.normal(0.0, 0.03, count)
    rates, phases = rng.uniform(0.15, 0.8, (4, count)), rng.uniform(0.0, 2.0 * np.pi, (4, count))
    sizes = rng.uniform(0.08, 0.2, (4, count))
    begins = np.cumsum(np.append(0.0, rng.uniform(0.9, 1.8, 40)))
    lasts = rng.uniform(0.5, 0.9, 40)
    goals = np.vstack([np.zeros(count), rng.normal(0.0, 0.35, (40, count))])

    def swing(t: np.ndarray) -> np.ndarray:
        ease = np.clip(t / 0.6, 0.0, 1.0)[:, None] ** 2
        waves = sizes * np.sin(2.0 * np.pi * rates * t[:, None, None] + phases)
        return start + ease * waves.sum(axis=1)

    def reach(t: np.ndarray) -> np.ndarray:
        stage = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, 39)
        share = np.clip((t - begins[stage]) / lasts[stage], 0.0, 1.0)[:, None]
        ease = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        return start + goals[stage] + ease * (goals[stage + 1] - goals[stage])

    return reach if world.reaches else swing


def draw_arm(world: World, angles: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """The arm at `angles` (K,) rad drawn over a picture."""
    turn, place = 0.0, world.base
    for length, angle, link in zip(world.lengths, angles, world.links, strict=True):
        turn += angle
        along = np.array([np.sin(turn), -np.cos(turn)])
        across = np.array([along[1], -along[0]])
        height, width = link.shape[:2]
        matrix = np.column_stack(
            [along * length / width, across * 11.0 / height, place - 5.5 * across]
        )
        warped = cv2.warpAffine(link, matrix, SIZE, flags=cv2.INTER_LINEAR)
        mask = cv2.warpAffine(np.full(link.shape[:2], 255, np.uint8), matrix, SIZE)
        picture[mask > 127] = warped[mask > 127]
        place = place + along * length
    return picture


def draw_episode(
    world: World, number: int, late_s: float = 0.0, moved: np.ndarray | None = None
) -> Episode:
    """A sound episode; its images are `late_s` later than the others', its cameras `moved` (2,3)."""
    rng = np.random.default_rng([world.seed, 3, number])
    seconds = rng.uniform(8.0, 11.0)
    angles = draw_motion(world, number, seconds)
    t = np.arange(int(seconds * FPS)) / FPS
    shown_t = t - world.delay_s - late_s - rng.normal(0.0, 0.003)
    if world.stored_twice:
        shown_t = shown_t[np.arange(len(t)) // 2 * 2]
    shown = angles(shown_t)
    places = rng.uniform([0.0, 0.0], [SIZE[0] - 18.0, SIZE[1] - 18.0], (len(world.things), 2))
    light = rng.uniform(0.96, 1.04)
    images = {}
    for camera, wall in zip(world.cameras, world.walls, strict=True):
        ground = wall.copy()
        for thing, (u, v) in zip(world.things, places.astype(int), strict=True):
            ground[v : v + 18, u : u + 18] = thing
        mirrored = -1.0 if camera == "side" else 1.0
        pictures = np.array([draw_arm(world, mirrored * q, ground.copy()) for q in shown])
        if moved is not None:
            edge = cv2.BORDER_REFLECT
            turned = [cv2.warpAffine(one, moved, SIZE, borderMode=edge) for one in pictures]
            pictures = np.array(turned)
        noise = rng.normal(0.0, 2.0, (*pictures.shape[:3], 1))
        if world.stored_twice:
            noise = noise[np.arange(len(t)) // 2 * 2]
        images[camera] = np.clip(light * pictures + noise, 0, 255).astype(np.uint8)
    state = angles(t) + rng.normal(0.0, world.noise_rad, (len(t), len(world.home)))
    if world.step_rad:
        state = np.round(state / world.step_rad) * world.step_rad
    return Episode(state, angles(t + world.lead_s), images)


def write_dataset(folder: Path, world: World, episodes: list[Episode]) -> Path:
    """A LeRobot v2.1 folder of the episodes."""
    lengths, count = [len(one.state) for one in episodes], len(world.home)
    features = {
        name: {"dtype": "float32", "shape": [count], "names": list(world.names)}
        for name in ("observation.state", "action")
    }
    features |= {
        feature_of(camera): {
            "dtype": "video",
            "shape": [SIZE[1], SIZE[0], 3],
            "names": ["height", "width", "channels"],
        }
        for camera in world.cameras
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    features |= {
        name: {"dtype": "int64", "shape": [1], "names": None}
        for name in ("frame_index", "episode_index", "index", "task_index")
    }
    drawn.info(folder, "v2.1", lengths, features=features, fps=FPS)
    starts = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    for number, one in enumerate(episodes):
        write_episode(folder, number, starts[number], one)
    listed = [
        {"episode_index": number, "tasks": ["reach"], "length": rows}
        for number, rows in enumerate(lengths)
    ]
    (folder / "meta/episodes.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in listed))
    (folder / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "reach"}\n')
    return folder


def feature_of(camera: str) -> str:
    """The feature of a camera."""
    return f"observation.images.{camera}"


def write_episode(folder: Path, number: int, first: int, one: Episode) -> None:
    """The table and the videos of an episode."""
    rows = len(one.state)
    columns = {
        "observation.state": one.state.astype(np.float32), "action": one.action.astype(np.float32),
        "timestamp": (np.arange(rows) / FPS).astype(np.float32), "frame_index": np.arange(rows),
        "episode_index": np.full(rows, number), "index": first + np.arange(rows),
        "task_index": np.zeros(rows, np.int64),
    }  # fmt: skip
    drawn.table(folder / f"data/chunk-000/episode_{number:06d}.parquet", columns)
    for camera, images in one.images.items():
        place = f"videos/chunk-000/{feature_of(camera)}/episode_{number:06d}.mp4"
        drawn.film(folder / place, images, crf="18", preset="ultrafast")


@dataclass(frozen=True)
class Fault:
    """A fault in episode `number`, or from it on (`lasting`): the episodes as stored, and a word of
    the figure or sentence that tells it."""

    name: str
    number: int
    changed: dict[int, Episode] = field(repr=False)
    report: str


KINDS = ("late camera", "frozen joint", "repeated frames", "moved camera", "swapped joints",
         "clipped joint", "wrong unit")  # fmt: skip


def draw_fault(world: World, kind: str, count: int) -> Fault:
    """One fault of a kind, its size and place by the world's seed, in a dataset of `count`
    episodes."""
    rng = np.random.default_rng([world.seed, 4])
    number = int(rng.integers(0, count))
    one = draw_episode(world, number)
    joint = int(rng.integers(0, len(world.home)))
    name = world.names[joint]
    state, action, images = one.state.copy(), one.action.copy(), dict(one.images)
    if kind == "late camera":
        late_s = float(rng.uniform(0.1, 0.2))
        return Fault(kind, number, {number: draw_episode(world, number, late_s)}, "delay/")
    if kind == "moved camera":
        return _moved_camera(world, rng, count)
    if kind == "repeated frames":
        times = 4 if world.stored_twice else 2
        images = {key: film[np.arange(len(film)) // times * times] for key, film in images.items()}
        return Fault(kind, number, {number: replace(one, images=images)}, "repeated/")
    if kind == "frozen joint":
        first = int(rng.integers(20, len(state) - 80))
        lasting = int(rng.uniform(1.5, 3.0) * FPS)
        state[first : first + lasting, joint] = state[first, joint]
        return Fault(kind, number, {number: replace(one, state=state)}, f"/{name}")
    if kind == "clipped joint":
        limit = np.quantile(state[:, joint], rng.uniform(0.6, 0.8))
        state[:, joint] = np.minimum(state[:, joint], limit)
        return Fault(kind, number, {number: replace(one, state=state)}, name)
    if kind == "wrong unit":
        state, action = np.rad2deg(state), np.rad2deg(action)
        return Fault(kind, number, {number: Episode(state, action, images)}, "size/")
    other = (joint + 1) % len(world.home)
    order = np.arange(len(world.home))
    order[[joint, other]] = other, joint
    state = state[:, order]
    if rng.random() < 0.5:
        action = action[:, order]
    return Fault(kind, number, {number: Episode(state, action, images)}, "swapped")


def _moved_camera(world: World, rng: np.random.Generator, count: int) -> Fault:
    """Moved by 3 to 10 px and turned by up to 2°, in one episode or from it on."""
    number = int(rng.integers(1, count))
    matrix = cv2.getRotationMatrix2D((80.0, 60.0), float(rng.uniform(-2.0, 2.0)), 1.0)
    way = rng.uniform(0.0, 2.0 * np.pi)
    matrix[:, 2] += rng.uniform(3.0, 10.0) * np.array([np.cos(way), np.sin(way)])
    last = count if rng.random() < 0.5 else number + 1
    changed = {k: draw_episode(world, k, moved=matrix) for k in range(number, last)}
    return Fault("moved camera", number, changed, "moved")
