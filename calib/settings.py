"""What a live calibration needs of the settings: the camera's section and the arm's."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Mapping, Optional

from apex_edge import plugins
from apex_edge.cameras.base import Camera, CameraConfig
from apex_edge.config import read_toml, structure
from apex_edge.errors import ConfigError
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ArmConfig

RECORDED = ("mcap", "video", "folder")


@dataclass(frozen=True)
class Bench:
    """Camera and arm as the settings name them; the rest of the file is not looked at."""

    camera: CameraConfig
    arm: ArmConfig
    where: str

    @classmethod
    def read(
        cls, config: Optional[Path], kind: Optional[str] = None, path: Optional[str] = None
    ) -> "Bench":
        """Read a settings file, or take the defaults, with the camera's kind and path replaced.

        Raises
        ------
        ConfigError : unreadable, or a key of these two sections is wrong.
        """
        data = read_toml(config) if config is not None else {}
        where = str(config or "defaults (no --config)")
        camera = structure(CameraConfig, _section(data, "camera", where), f"{where} [camera]")
        arm = structure(ArmConfig, _section(data, "arm", where), f"{where} [arm]")
        camera = replace(
            camera, type=kind or camera.type, path=camera.path if path is None else path
        )
        return cls(camera, arm, where)

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

    def open_camera(self, is_now: bool = True) -> Camera:
        """Make the camera, without its calibration: that is what is being measured.

        Stamps are those of the grab, with no latency taken off. With ``is_now`` it must see the
        present.

        Raises
        ------
        ConfigError : it shows what no calibration can use. PluginError : no such camera.
        """
        kind = self.camera.type
        if kind == "twin":
            raise ConfigError("camera type 'twin' shows no board; type 'board' simulates one")
        if is_now and kind in RECORDED:
            raise ConfigError(f"{self.where} [camera]: type = {kind!r} is no camera that sees now")
        bare = replace(self.camera, calibration="", latency_s=0.0)
        camera: Camera = plugins.load("cameras", kind)(bare)
        return camera


def _section(data: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    section = data.get(name, {})
    if not isinstance(section, Mapping):
        raise ConfigError(f"{where}: {name} must be a table, found {section!r}")
    return section
