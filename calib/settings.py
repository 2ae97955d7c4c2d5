"""What a live calibration needs of the settings file: the camera's section and the arm's."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Mapping

from apex_edge import plugins
from apex_edge.cameras.base import Camera, CameraConfig
from apex_edge.config import read_toml, structure
from apex_edge.errors import ConfigError
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ArmConfig


@dataclass(frozen=True)
class Bench:
    """Camera and arm as the settings name them; the rest of the file is not looked at."""

    camera: CameraConfig
    arm: ArmConfig
    where: str

    @classmethod
    def read(cls, path: Path) -> "Bench":
        """Read a settings file.

        Raises
        ------
        ConfigError : unreadable, or a key of these two sections is wrong.
        """
        data = read_toml(path)
        camera = structure(CameraConfig, _section(data, "camera", path), f"{path} [camera]")
        arm = structure(ArmConfig, _section(data, "arm", path), f"{path} [arm]")
        return cls(camera, arm, str(path))

    def model(self) -> ArmModel:
        """Load the arm's data.

        Raises
        ------
        ConfigError : no such arm, or no port is named.
        """
        if self.arm.port in ("", "sim"):
            raise ConfigError(
                f"{self.where} [arm]: port = {self.arm.port!r}; name the serial port of a real arm"
            )
        return ArmModel.load(self.arm.type)

    def open_camera(self) -> Camera:
        """Make the live camera, without its calibration: that is what is being measured.

        Stamps are those of the grab, with no latency taken off.

        Raises
        ------
        ConfigError : the source is not live. PluginError : no such camera.
        """
        if self.camera.type in ("twin", "mcap", "video", "folder"):
            raise ConfigError(
                f"{self.where} [camera]: type = {self.camera.type!r} is no camera that sees now"
            )
        bare = replace(self.camera, calibration="", latency_s=0.0)
        camera: Camera = plugins.load("cameras", self.camera.type)(bare)
        return camera


def _section(data: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    section = data.get(name, {})
    if not isinstance(section, Mapping):
        raise ConfigError(f"{path}: {name} must be a table, found {section!r}")
    return section
