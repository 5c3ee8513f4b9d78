"""Small datasets written without bodylog's writers: by pyarrow, h5py and PyAV, as the formats' own tools do."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from bodylog.runtime.blas_threads import without_real_time

arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'bodylog[datasets]'")
parquet = pytest.importorskip("pyarrow.parquet")
av = pytest.importorskip("av", reason="PyAV is not installed: pip install 'bodylog[datasets]'")
h5py = pytest.importorskip("h5py", reason="h5py is not installed: pip install 'bodylog[datasets]'")

FPS, SIZE = 20, (64, 64)
JOINTS = ("shoulder", "elbow", "gripper")
CAMERA = "observation.images.top"


def angles(rows: int, seed: int = 0) -> np.ndarray:
    """Joint angles (rows,3), rad, in float32."""
    t = np.arange(rows)[:, None] / FPS
    return np.sin(t * [1.0, 2.0, 3.0] + seed).astype(np.float32)


def images(rows: int, seed: int = 0) -> np.ndarray:
    """Images (rows,64,64,3) BGR: a bright square that moves over noise."""
    rng = np.random.default_rng(seed)
    found = rng.integers(60, 120, (rows, SIZE[1], SIZE[0], 3), np.uint8)
    for row in range(rows):
        found[row, 8:24, (2 * row) % 40 : (2 * row) % 40 + 16] = (40, 200, 90)
    return found


def film(path: Path, pictures: np.ndarray, codec: str = "libx264", **options: str) -> None:
    """Write a video of images (N,H,W,3) BGR at FPS."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(FPS), options=options)
        stream.height, stream.width = pictures.shape[1:3]
        stream.pix_fmt = "yuv420p"
        with without_real_time():
            stream.codec_context.open()
        for image in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())


def decoded(path: Path) -> list[np.ndarray]:
    """A video's images, by PyAV alone."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]


def table(path: Path, columns: dict, groups: int | None = None) -> None:
    """Write columns like LeRobot's tables: vectors as lists."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made = {name: list(values) if np.ndim(values[0]) == 1 else values for name, values in columns.items()}
    parquet.write_table(arrow.table(made), path, row_group_size=groups)


def info(folder: Path, version: str, lengths: list[int], **more: object) -> None:
    """Write meta/info.json."""
    v3 = version.startswith("v3")
    file = "chunk-{chunk_index:03d}/file-{file_index:03d}" if v3 else None
    old = "chunk-{episode_chunk:03d}"
    names = list(JOINTS)
    features = {
        "observation.state": {"dtype": "float32", "shape": [3], "names": names},
        "action": {"dtype": "float32", "shape": [3], "names": names},
        "next.done": {"dtype": "bool", "shape": [1], "names": None},
        CAMERA: {"dtype": "video", "shape": [64, 64, 3], "names": ["height", "width", "channels"]},
        **{name: {"dtype": "int64", "shape": [1], "names": None} for name in ("frame_index", "episode_index", "index")},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        "task_index": {"dtype": "int64", "shape": [1], "names": None},
    }
    content = {
        "codebase_version": version, "robot_type": "drawn", "total_episodes": len(lengths), "fps": FPS,
        "total_frames": sum(lengths), "total_tasks": 1, "chunks_size": 1000, "features": features,
        "data_path": f"data/{file}.parquet" if v3 else f"data/{old}/episode_{{episode_index:06d}}.parquet",
        "video_path": f"videos/{{video_key}}/{file}.mp4" if v3
        else f"videos/{old}/{{video_key}}/episode_{{episode_index:06d}}.mp4",
    }  # fmt: skip
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "meta" / "info.json").write_text(json.dumps(content | more))


def columns(number: int, rows: int, first: int = 0) -> dict:
    """The columns of one episode."""
    q = angles(rows, number)
    return {
        "observation.state": q, "action": q + np.float32(0.01), "next.done": np.arange(rows) == rows - 1,
        "timestamp": (np.arange(rows) / FPS).astype(np.float32), "frame_index": np.arange(rows),
        "episode_index": np.full(rows, number), "index": first + np.arange(rows), "task_index": np.zeros(rows, int),
    }  # fmt: skip


def v21(folder: Path, lengths: list[int], codec: str = "libx264", **more: object) -> Path:
    """A LeRobot v2.1 folder."""
    info(folder, "v2.1", lengths, **more)
    for number, rows in enumerate(lengths):
        table(folder / f"data/chunk-000/episode_{number:06d}.parquet", columns(number, rows))
        film(folder / f"videos/chunk-000/{CAMERA}/episode_{number:06d}.mp4", images(rows, number), codec)
    listed = [{"episode_index": number, "tasks": ["push"], "length": rows} for number, rows in enumerate(lengths)]
    (folder / "meta/episodes.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in listed))
    (folder / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "push"}\n')
    return folder


def v30(folder: Path, lengths: list[int], codec: str = "libsvtav1") -> Path:
    """A LeRobot v3.0 folder: all episodes in one table and one video of each camera."""
    info(folder, "v3.0", lengths)
    starts = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    parts = [columns(number, rows, starts[number]) for number, rows in enumerate(lengths)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    table(folder / "data/chunk-000/file-000.parquet", whole, groups=7)
    pictures = np.concatenate([images(rows, number) for number, rows in enumerate(lengths)])
    film(folder / f"videos/{CAMERA}/chunk-000/file-000.mp4", pictures, codec)
    listed = {
        "episode_index": list(range(len(lengths))), "tasks": [["push"]] * len(lengths), "length": lengths,
        "data/chunk_index": [0] * len(lengths), "data/file_index": [0] * len(lengths),
        "dataset_from_index": starts[:-1], "dataset_to_index": starts[1:],
        f"videos/{CAMERA}/chunk_index": [0] * len(lengths), f"videos/{CAMERA}/file_index": [0] * len(lengths),
        f"videos/{CAMERA}/from_timestamp": [first / FPS for first in starts[:-1]],
        f"videos/{CAMERA}/to_timestamp": [end / FPS for end in starts[1:]],
    }  # fmt: skip
    path = folder / "meta/episodes/chunk-000/file-000.parquet"
    path.parent.mkdir(parents=True)
    parquet.write_table(arrow.table(listed), path)
    parquet.write_table(arrow.table({"task_index": [0], "task": ["push"]}), folder / "meta/tasks.parquet")
    return folder


def aloha(path: Path, rows: int = 20, packed: bool = False) -> Path:
    """An ALOHA episode of two arms, one camera in RGB, or in rows of JPEG padded with zeros."""
    import cv2

    pictures = images(rows)
    with h5py.File(path, "w") as file:
        file["observations/qpos"] = np.sin(np.arange(rows)[:, None] * 0.1 + np.arange(14))
        file["observations/qvel"] = np.zeros((rows, 14))
        file["action"] = np.cos(np.arange(rows)[:, None] * 0.1 + np.arange(14))
        if packed:
            encoded = [cv2.imencode(".jpg", image)[1].reshape(-1) for image in pictures]
            filled = np.zeros((rows, max(map(len, encoded))), np.uint8)
            for row, data in enumerate(encoded):
                filled[row, : len(data)] = data
            file["observations/images/top"] = filled
        else:
            file["observations/images/top"] = pictures[..., ::-1]
        file.attrs["sim"] = True
    return path


def robomimic(path: Path, demos: tuple[int, ...] = (0, 1, 3), rows: int = 12) -> Path:
    """robomimic's demonstrations, recorded at 25 Hz."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": {"control_freq": 25}})
        for number in demos:
            demo = data.create_group(f"demo_{number}")
            demo["obs/robot0_joint_pos"] = np.full((rows, 7), float(number)) + np.arange(rows)[:, None] * 0.01
            demo["obs/agentview_image"] = images(rows, number)[..., ::-1]
            demo["actions"] = np.zeros((rows, 7))
            demo["rewards"] = np.zeros(rows)
    return path


def droid(folder: Path, rows: int = 12) -> Path:
    """A DROID trajectory: nested groups, times in ms, the video of a camera beside."""
    (folder / "recordings/MP4").mkdir(parents=True)
    ms = 1_678_453_535_000 + 66 * np.arange(rows)
    with h5py.File(folder / "trajectory.h5", "w") as file:
        positions = np.arange(rows)[:, None] * 0.01 + np.arange(7) * 0.1
        file["action/joint_position"] = positions + 0.005
        file["action/robot_state/joint_positions"] = np.zeros((rows, 7))
        file["observation/robot_state/joint_positions"] = positions
        file["observation/camera_type/22008760"] = np.ones(rows, int)
        file["observation/timestamp/control/step_start"] = ms
        file["observation/timestamp/cameras/22008760_estimated_capture"] = ms + 5
    film(folder / "recordings/MP4/22008760.mp4", images(rows))
    film(folder / "recordings/MP4/22008760-stereo.mp4", images(rows))
    return folder / "trajectory.h5"


def mixed(folder: Path, rows: int = 12) -> Path:
    """A folder with images and their table, a video and its times, and a table of joints."""
    import cv2

    (folder / "frames").mkdir(parents=True)
    pictures = images(rows)
    names = [f"frames/{row:03d}.png" for row in range(rows)]
    for name, image in zip(names, pictures, strict=True):
        cv2.imwrite(str(folder / name), image)
    lines = [f"{1700000000 + row / FPS:.3f},{name}" for row, name in enumerate(names)]
    (folder / "wrist.csv").write_text("\n".join(["unix_s,file", *lines]))
    film(folder / "side.mp4", pictures)
    times = [f"{1700000000 + row / FPS + 0.004 * (row % 2):.3f}" for row in range(rows)]
    (folder / "side_timestamps.csv").write_text("\n".join(["t", *times]))
    lines = [f"{1700000000 + row / 50:.3f},{row * 0.01:.2f},{row * -0.02:.2f}" for row in range(2 * rows)]
    (folder / "joints.csv").write_text("\n".join(["t,pan,lift", *lines]))
    return folder
