"""The map of a robot's surface: landmarks are found again where they are, in every image or every n-th."""

import cv2
import numpy as np

from bodylog.body_model import PATCH_PX, LandmarkMap
from bodylog.kinematics.landmark_adjustment import Landmarks
from bodylog.kinematics.landmark_map import predict_landmarks
from bodylog.perception.surface.corner_tracks import KeyFrames
from bodylog.surface.map import find_again
from tests.kinematics.landmark_arm import model, motion, truth

T = 2.0 + np.arange(6) * 0.02
HEIGHT, WIDTH, COUNT = 480, 640, 3


def test_landmarks_are_found_again_in_every_image_or_every_second():
    built = model([motion(1)])
    phi = truth(built)
    body = np.array([1, 2, 3])
    landmarks = Landmarks(body, np.array([built.bodies[b].centre for b in body]))
    there = predict_landmarks(built, phi, landmarks, T, 0, HEIGHT)
    rng = np.random.default_rng(2)
    patches = np.array([cv2.GaussianBlur(rng.uniform(0, 255, (PATCH_PX, PATCH_PX)), (0, 0), 1.2) for _ in body])
    patches = patches.astype(np.uint8)
    shift = np.array([3, -2])
    planted = np.rint(there.image).astype(int) + shift
    images = []
    for frame in range(len(T)):
        image = rng.integers(100, 140, (HEIGHT, WIDTH)).astype(np.uint8)
        for patch, (u, v) in zip(patches, planted[:, frame], strict=True):
            half = PATCH_PX // 2
            image[v - half : v + half + 1, u - half : u + half + 1] = patch
        images.append(image)
    known = LandmarkMap(
        body, landmarks.places, np.zeros((COUNT, 3, 3)), np.zeros((COUNT, 3, len(phi))), np.arange(COUNT), patches,
        there.by_place[:, 0],
    )  # fmt: skip
    keys = [KeyFrames(T, tuple(images))]
    for every in (1, 2):
        found = find_again(built, phi, known, landmarks, keys, 8, every)
        assert found is not None
        assert found.possible.tolist() == [len(T[::every])] * COUNT
        assert found.seen.lengths.tolist() == [len(T[::every])] * COUNT
        assert found.seen.t.tolist() == T[::every].tolist() * COUNT
        np.testing.assert_allclose(found.seen.uv.reshape(COUNT, -1, 2), planted[:, ::every], atol=0.6)
