"""What Rerun's window shows, drawn without a screen: a soak test, where a Vulkan driver is at hand."""

import os
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from bodylog.overlay_style import PREDICTED
from bodylog.report.viewers import rerun_process

DRIVERS = os.environ.get("VK_ICD_FILENAMES") or [*Path("/usr/share/vulkan/icd.d").glob("*.json")]
pytestmark = [
    pytest.mark.soak,
    pytest.mark.skipif(find_spec("rerun_cli") is None, reason="needs rerun-sdk (pip install 'bodylog[view]')"),
    pytest.mark.skipif(not DRIVERS, reason="needs a Vulkan driver (Debian: mesa-vulkan-drivers)"),
]


@pytest.fixture
def window(run_cli, robot, tmp_path):
    """A headless window on the small robot's estimate: its address."""
    out, recorded = tmp_path / "out.mcap", tmp_path / "out.rrd"
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", out) == 0
    assert run_cli("view", out, "-o", recorded) == 0
    rerun_process.disable_analytics(tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [Path(find_spec("rerun_cli").origin).with_name("rerun"), "--headless", "--bind", "127.0.0.1"]
    command += ["--port", str(port), "--window-size", "900x600", recorded]
    shown = subprocess.Popen(command, env={**os.environ, "HOME": str(tmp_path)}, stderr=subprocess.DEVNULL)
    yield f"rerun+http://127.0.0.1:{port}/proxy"
    shown.terminate()
    shown.wait(10)


SHOT = "import sys; from rerun.experimental import ViewerClient; ViewerClient(sys.argv[1]).save_screenshot(sys.argv[2])"


def test_viewer_draws_the_prediction_on_the_image(window, tmp_path):
    import cv2
    import numpy as np

    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        shot = tmp_path / f"{time.monotonic_ns()}.png"
        subprocess.run([sys.executable, "-c", SHOT, window, str(shot)], timeout=30, capture_output=True)
        time.sleep(0.5)
        if shot.exists() and (image := cv2.imread(str(shot))) is not None:
            picture = image[40 : image.shape[0] // 3, : image.shape[1] // 2].astype(int)
            near = np.abs(picture - PREDICTED.rgb[::-1]).max(axis=2) < 40
            if near.sum() > 20 and (picture.max(axis=2) > 60).mean() > 0.2:
                return
    pytest.fail("no prediction on the picture within a minute")
