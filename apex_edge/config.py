"""Strict settings: one TOML file, one frozen dataclass per section, beside the stage it sets.

A default lives in the dataclass and nowhere else. An unknown key, a wrong type or a value out of
range is a ConfigError that names the file, the key, the nearest valid key and the allowed range.
"""

import difflib
from dataclasses import MISSING, Field, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple, Type, TypeVar, Union, get_type_hints

import cattrs
import tomli

from apex_edge.errors import ConfigError

T = TypeVar("T")


def setting(
    default: Any,
    doc: str,
    low: Optional[float] = None,
    high: Optional[float] = None,
    choices: Tuple[str, ...] = (),
) -> Any:
    """Declare one field of a settings dataclass.

    Parameters
    ----------
    default : value used when the file says nothing (immutable).
    doc : one line with the unit, shown in the reference.
    low, high : allowed range, both ends included.
    choices : allowed strings.
    """
    return field(
        default=default, metadata={"doc": doc, "low": low, "high": high, "choices": choices}
    )


def read_toml(path: Union[str, Path]) -> Dict[str, Any]:
    """Read a TOML file into plain values.

    Raises
    ------
    ConfigError : the file cannot be read or is not TOML.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot read the settings file: {error}") from error
    try:
        return tomli.loads(text)
    except tomli.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


def structure(kind: Type[T], values: Mapping[str, Any], where: str) -> T:
    """Build one settings dataclass from plain values, strictly.

    Parameters
    ----------
    kind : a frozen dataclass whose fields were declared with ``setting`` or are such dataclasses.
    values : what the file said, e.g. ``{"window": 5}``.
    where : file and section for the message, e.g. ``apex.toml [perception]``.

    Raises
    ------
    ConfigError : unknown key, wrong type, missing key or value out of range.
    """
    hints = get_type_hints(kind)
    known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    built: Dict[str, Any] = {}
    for key, value in values.items():
        if key not in known:
            raise ConfigError(f"{where}: unknown key {key!r}{_nearest(key, list(known))}")
        built[key] = _convert(known[key], hints[key], value, where)
    for name, spec in known.items():
        if name not in built and spec.default is MISSING and spec.default_factory is MISSING:
            raise ConfigError(f"{where}: key {name!r} is missing")
    return kind(**built)


def _convert(spec: "Field[Any]", hint: Any, value: Any, where: str) -> Any:
    if is_dataclass(hint):
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where}: {spec.name} must be a table, found {value!r}")
        return structure(hint, value, f"{where}.{spec.name}")
    if not _matches(hint, value):
        raise ConfigError(
            f"{where}: {spec.name} = {value!r} has the wrong type, expected {_type_name(hint)}"
        )
    converted = cattrs.structure(value, hint)
    _check_range(spec, converted, where)
    return converted


def _matches(hint: Any, value: Any) -> bool:
    """Say whether a TOML value fits a type, without cattrs' kind coercions ("5" -> 5)."""
    arguments: Tuple[Any, ...] = getattr(hint, "__args__", ())
    origin = getattr(hint, "__origin__", None)
    if origin is Union:
        return any(_matches(option, value) for option in arguments if option is not type(None))
    if origin is tuple:
        if not isinstance(value, list):
            return False
        inner = arguments[0]
        is_open = len(arguments) == 2 and arguments[1] is Ellipsis
        return (is_open or len(value) == len(arguments)) and all(_matches(inner, v) for v in value)
    if hint is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, hint)


def _type_name(hint: Any) -> str:
    return getattr(hint, "__name__", None) or str(hint).replace("typing.", "")


def _check_range(spec: "Field[Any]", value: Any, where: str) -> None:
    low, high = spec.metadata.get("low"), spec.metadata.get("high")
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            continue
        # written so that NaN fails as well
        if (low is not None and not number >= low) or (high is not None and not number <= high):
            raise ConfigError(f"{where}: {spec.name} = {value!r} is outside [{low}, {high}]")
        if number != number:
            raise ConfigError(f"{where}: {spec.name} = {value!r} is not a number")
    choices = spec.metadata.get("choices") or ()
    if choices and value not in choices:
        raise ConfigError(
            f"{where}: {spec.name} = {value!r} is not one of {', '.join(choices)}"
            f"{_nearest(str(value), list(choices))}"
        )


def _nearest(word: str, known: List[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(sorted(known))}"
