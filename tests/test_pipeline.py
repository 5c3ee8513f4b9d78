from pathlib import Path

import pytest

from bodylog import pipeline
from bodylog.errors import UsageError
from bodylog.settings import Settings


@pytest.mark.parametrize("out", ["a.mcap", "b.mcap", "body.npz", "link.npz"])
def test_what_is_read_is_never_written_to(out: str, tmp_path: Path) -> None:
    first, second, body = (tmp_path / name for name in ("a.mcap", "b.mcap", "body.npz"))
    for path in (first, second, body):
        path.write_bytes(b"precious")
    (tmp_path / "link.npz").symlink_to(body)
    with pytest.raises(UsageError, match=f"{out}: is read here"):
        pipeline.fit([first, second], tmp_path / out, Settings(), update=body)
    if out != "b.mcap":
        with pytest.raises(UsageError, match=f"{out}: is read here"):
            pipeline.estimate(first, body, tmp_path / out, Settings())
    assert all(path.read_bytes() == b"precious" for path in (first, second, body))
