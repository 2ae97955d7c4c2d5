"""Where the LLM is and how to speak to it: environment overrides, URL rules, the secret key."""

import ipaddress
import os
import stat
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Mapping, Optional
from urllib.parse import urlsplit

from apex_edge.errors import PlannerError
from apex_edge.planners.base import PlannerConfig

KEY_FILE_LIMIT_BYTES = 4096
CHAT_PATH = "/chat/completions"


class Secret:
    """Hold a key so that no repr, log line or exception can show it by accident."""

    __slots__ = ("_value",)

    def __init__(self, value: str) -> None:
        self._value = value

    def reveal(self) -> str:
        """Return the key; only the code that writes the Authorization header asks for it."""
        return self._value

    def __repr__(self) -> str:
        return "<secret>"

    def __reduce__(self) -> str:
        raise TypeError("a secret is never serialised")


@dataclass(frozen=True)
class Endpoint:
    """One chat-completions address; an empty ``model`` or ``ca_file`` means none is set."""

    url: str
    model: str
    key: Optional[Secret]
    ca_file: str


def with_environment(config: PlannerConfig, env: Mapping[str, str]) -> PlannerConfig:
    """Return the settings with APEX_LLM_BASE_URL and APEX_LLM_MODEL applied, where not empty."""
    return replace(
        config,
        base_url=env.get("APEX_LLM_BASE_URL", "").strip() or config.base_url,
        model=env.get("APEX_LLM_MODEL", "").strip() or config.model,
    )


def endpoint_from(config: PlannerConfig, env: Mapping[str, str]) -> Endpoint:
    """Check the settings and build the endpoint they describe.

    Raises
    ------
    PlannerError : URL missing or unsafe, CA file missing, key or key file not usable.
    """
    config = with_environment(config, env)
    if config.ca_file and not Path(config.ca_file).is_file():
        raise PlannerError(f"{config.ca_file}: the CA file of [planner] ca_file does not exist")
    return Endpoint(
        url=chat_url(config.base_url),
        model=config.model,
        key=find_key(config, env),
        ca_file=config.ca_file,
    )


def chat_url(base_url: str) -> str:
    """Return the chat-completions address under ``base_url``.

    Raises
    ------
    PlannerError : not an absolute http(s) URL, plain http to another machine, or a URL that
        carries a user name, a query or a fragment.
    """
    try:
        parts = urlsplit(base_url)
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise PlannerError(f"the LLM base URL cannot be read: {error}") from None
    if parts.username is not None or parts.password is not None:
        raise PlannerError("the LLM base URL carries a user name; give a key by APEX_LLM_API_KEY")
    if parts.scheme not in ("http", "https") or not host:
        raise PlannerError(f"LLM base URL {base_url!r}: expected http://host/... or https://...")
    if parts.query or parts.fragment or any(c.isspace() for c in base_url):
        raise PlannerError(f"LLM base URL of {host}: no query, fragment or space is allowed")
    if parts.scheme == "http" and not is_loopback(host):
        raise PlannerError(
            f"LLM base URL {base_url!r}: https is required, except to this machine (127.0.0.1)"
        )
    trimmed = base_url.rstrip("/")
    return trimmed if trimmed.endswith(CHAT_PATH) else trimmed + CHAT_PATH


def is_loopback(host: str) -> bool:
    """Say whether a host name or address can only mean this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def find_key(config: PlannerConfig, env: Mapping[str, str]) -> Optional[Secret]:
    """Look the key up: APEX_LLM_API_KEY, APEX_LLM_API_KEY_FILE, ``api_key_env``, ``api_key_file``.

    Raises
    ------
    PlannerError : the variable named by ``api_key_env`` is not set, the file cannot be read or
        others can read it, or what was found cannot be a key.
    """
    if env.get("APEX_LLM_API_KEY", "").strip():
        return _checked(env["APEX_LLM_API_KEY"], "APEX_LLM_API_KEY")
    if env.get("APEX_LLM_API_KEY_FILE", "").strip():
        return read_key_file(env["APEX_LLM_API_KEY_FILE"].strip())
    if config.api_key_env:
        if not env.get(config.api_key_env, "").strip():
            raise PlannerError(
                f"[planner] api_key_env names the variable {config.api_key_env}, which is not set"
            )
        return _checked(env[config.api_key_env], config.api_key_env)
    return read_key_file(config.api_key_file) if config.api_key_file else None


def read_key_file(path: str) -> Secret:
    """Read a key from a file that only its owner can read.

    Raises
    ------
    PlannerError : the file cannot be read, is not a plain file, is open to group or others, or
        holds no key.
    """
    if not Path(path).is_file():
        raise PlannerError(f"{path}: the key file does not exist or is not a plain file")
    try:
        with Path(path).open("rb") as file:
            status = os.fstat(file.fileno())
            data = file.read(KEY_FILE_LIMIT_BYTES + 1)
    except OSError as error:
        raise PlannerError(f"{path}: cannot read the key file: {error.strerror}") from None
    if os.name == "posix" and status.st_mode & 0o077:
        raise PlannerError(
            f"{path}: the key file has mode {stat.S_IMODE(status.st_mode):04o}, so others may use "
            f"the key; run: chmod 600 {path}"
        )
    return _checked(data.decode("ascii", "replace"), path)


def _checked(text: str, where: str) -> Secret:
    """Refuse what cannot be a key; the message never shows it."""
    key = text.strip()
    if not key or len(key) > KEY_FILE_LIMIT_BYTES:
        raise PlannerError(f"{where}: holds no usable key (empty or too long)")
    if not all("!" <= letter <= "~" for letter in key):
        raise PlannerError(f"{where}: the key has a space, line break or non-ASCII character")
    return Secret(key)
