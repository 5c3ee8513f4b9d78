"""Options of a recording, their possible values, and which exclude each other."""

from dataclasses import dataclass

from ..choices import CAMERAS, FEATURES, IMAGES, SCENES
from ..errors import UsageError
from .plan import ScenarioPlan, describe_unknown_name

SIZES = {"ball": 0.05, "tag": 0.08, "none": 0.0}
"""Default diameter of the ball and side of the tag's black square (m)."""


@dataclass(frozen=True)
class Options:
    """Options of a recording; duration (s), noise (encoders, rad), variant and place: the
    scenario's own when None.

    size: image size in px. marker: a blue ball on the arm, for a second visual sense.
    cameras: 2 adds one at the side. turning: the head turns, one more joint. feature:
    the thing on the arm, or for a camera on the wrist the one in the scene;
    feature_size in m. clutter: things of the feature's colour, a foreign tag and
    furniture. split_joints: arm, head and gripper publish on separate topics. camera:
    the first camera's mount. hardware: errors of real joints and encoders, as typed
    (`parse_hardware`). scene: "bare" has no feature; links and wall have a texture
    instead, and before a camera on the wrist there are stones.
    """

    seed: int = 0
    duration: float | None = None
    image: str = "jpeg"
    size: tuple[int, int] = (640, 480)
    noise: float | None = None
    full: bool = False
    arm: str = "ur5"
    variant: str | None = None
    place: str | None = None
    marker: bool = False
    cameras: int = 1
    turning: bool = False
    feature: str = "ball"
    feature_size: float | None = None
    clutter: bool = False
    split_joints: bool = False
    camera: str = "head"
    hardware: str = ""
    scene: str = "plain"

    @property
    def side(self) -> float:
        """Diameter of the ball or side of the tag in m."""
        return SIZES[self.feature] if self.feature_size is None else self.feature_size


def check_options(options: Options) -> None:
    """UsageError when a value is not possible."""
    for name, value, possible in (
        ("image", options.image, IMAGES),
        ("feature", options.feature, FEATURES),
        ("camera", options.camera, CAMERAS),
        ("scene", options.scene, SCENES),
    ):
        if value not in possible:
            raise UsageError(
                f"{describe_unknown_name(name, value, possible)}; type: --{name} {possible[0]}"
            )
    require_within("seed", options.seed, 0, 2**63)
    require_within("width", options.size[0], 64, 4096)
    require_within("height", options.size[1], 48, 4096)
    require_within("cameras", options.cameras, 1, 2)
    if options.scene == "bare" and (
        options.feature == "tag" or options.marker or options.feature_size is not None
    ):
        raise UsageError(
            "--scene bare: it has no feature; leave --feature, --feature-size and --marker out"
        )
    if options.feature == "none" and options.feature_size is not None:
        raise UsageError(
            "--feature-size: there is no feature (--feature none); leave --feature-size out"
        )
    if options.feature != "none":
        require_within("feature-size", options.side, 0.005, 0.5)


def check_camera(scenario: str, plan: ScenarioPlan, options: Options) -> None:
    """UsageError for options of the head's camera with a camera on the wrist."""
    if options.camera == "head":
        return
    asked = {
        "--marker": options.marker,
        "--cameras": options.cameras > 1,
        "--turning": options.turning,
    }
    for option, given in asked.items():
        if given:
            raise UsageError(
                f"{option} needs the head's camera (--camera wrist was given); leave {option} out"
            )
    if plan.contacts:
        raise UsageError(
            f"scenario {scenario}: the head's camera shows the touching hand; type: --camera head"
        )


def require_within(name: str, value: float, low: float, high: float) -> None:
    """UsageError when the value of `--name` is not between low and high."""
    if not low <= value <= high:
        raise UsageError(
            f"{name} is {value}; possible: {low} to {high:g}; type: --{name} with such a number"
        )
