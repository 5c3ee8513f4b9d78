"""Read a log, and observe its features."""

from functools import partial
from pathlib import Path

from ..io.text_paths import with_text_paths
from ..logs.protocol import Progress
from ..settings import Settings
from ..types import Features, FrameConsumer, Recording
from .defaults import search_again_without_default
from .observed import add_recorded_joints, moving_features, still_pose_features

_DEFAULTS = Settings()


@with_text_paths
def observe(
    log: Path, settings: Settings = _DEFAULTS, progress: Progress | None = None, guess: bool = False
) -> tuple[Recording, Features]:
    """A log as signals, and what perception finds in it;
    tracks and touches the log already carries are taken over.

    `guess`: where nothing is configured and the default colour is not the arm's, what moves as the
    joints do is followed; the recording's settings then name it.
    """
    from .. import perception
    from ..recording import recording

    def make_searcher() -> FrameConsumer:
        return perception.frame_searcher(settings, progress)

    read = recording.read_recording(log, settings, settings.input.strict, make_searcher)
    look = still_pose_features if read.signals.poses else moving_features
    found = look(read, settings, progress)
    if guess:
        read, found = search_again_without_default(
            log, read, found, settings, partial(look, progress=progress)
        )
    return read, add_recorded_joints(read, found)
