"""Every error the project raises on purpose, in one tree.

::

    ApexError
    +-- ConfigError            a setting: unknown key, wrong type, out of range
    +-- PluginError            a name no registry knows, or a plug-in that cannot be loaded
    +-- InputError             something handed in from outside is not usable
    |   +-- RecordingError     a video, folder or MCAP file that cannot be read
    |   +-- ColourError        colour file or sample that cannot be used
    |   +-- CalibrationError   camera or table calibration missing or not usable
    |   +-- WeightsError       trigger weights: version, hash, range or golden vector wrong
    +-- CameraError            a live camera that cannot be opened or stopped delivering
    +-- ArmError               see firmware_bridge.errors, which derives from this
    +-- PlannerError           an LLM endpoint set up in a way that can never work

Each class has a ``slug``; ``docs/errors.md#<slug>`` lists message, cause and cure.
"""


class ApexError(Exception):
    """Base of every error raised on purpose.

    The message names the file, key or port, what was found and what was expected.
    """

    slug = "apex-error"
    exit_code = 2


class ConfigError(ApexError):
    """Refuse a setting: unknown key, wrong type, or value out of range."""

    slug = "config"


class PluginError(ApexError):
    """Refuse a registry name that is unknown, or a plug-in that fails to load."""

    slug = "plugin"


class InputError(ApexError):
    """Refuse something handed in from outside."""

    slug = "input"


class RecordingError(InputError):
    """Refuse a video, folder or MCAP file that cannot be read or was cut short."""

    slug = "recording"


class ColourError(InputError):
    """Refuse a colour file or a colour sample."""

    slug = "colour"


class CalibrationError(InputError):
    """Refuse a camera or table calibration."""

    slug = "calibration"


class WeightsError(InputError):
    """Refuse trigger weights: version, hash, range or golden vector wrong."""

    slug = "weights"


class CameraError(ApexError):
    """Report a live camera that cannot be opened or stopped delivering."""

    slug = "camera"


class ArmError(ApexError):
    """Base of everything the arm side raises (see firmware_bridge.errors)."""

    slug = "arm"


class PlannerError(ApexError):
    """Refuse a planner set-up that can never work (bad URL, unreadable key file)."""

    slug = "planner"
