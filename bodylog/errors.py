"""Everything that can go wrong for a reason we know, and the exit code each kind ends with.

BodylogError            1
├── UsageError          2    what was typed
│   └── ConfigError     2    what robot.toml says
├── PartError           3    part of the work was lost; what is done is kept
├── BoundError          4    a bound of --fail-if was broken
├── InputError          65   what was given cannot be used
│   ├── LogError        65   a log: not one, empty, a role or field missing
│   ├── FormatError     65   a definition, payload or picture that contradicts itself
│   ├── ModelError      65   a body model: not one, wrong version, another robot's
│   └── EvidenceError   65   a named sense contributed nothing
└── OutputError         73   an output cannot be created: no folder, protected, something else in its place
    └── WriteError      74   an output cannot be written: disk full, I/O error
"""


class BodylogError(Exception):
    """Base: the message is one line naming file, topic,
    field, value found, values possible, what to type next.
    """

    exit_code = 1


class UsageError(BodylogError):
    """What was typed makes no sense."""

    exit_code = 2


class ConfigError(UsageError):
    """What robot.toml says makes no sense."""


class PartError(BodylogError):
    """Part of the work was lost; what is done is kept."""

    exit_code = 3


class BoundError(BodylogError):
    """A bound was broken."""

    exit_code = 4


class InputError(BodylogError):
    """What was given cannot be used."""

    exit_code = 65


class LogError(InputError):
    """The log is not one, is empty, or lacks what was asked of it."""


class FormatError(InputError):
    """A definition, payload or picture contradicts itself."""


class ModelError(InputError):
    """The body model is not one, is of another version, or belongs to another robot."""


class EvidenceError(InputError):
    """A named sense contributed no observation."""


class OutputError(BodylogError):
    """An output cannot be created."""

    exit_code = 73


class WriteError(OutputError):
    """An output cannot be written to its end."""

    exit_code = 74
