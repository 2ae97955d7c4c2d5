"""Read and write model documents: readable ``.json`` or compact ``.npz``, both the same content.

A document is a dict of plain values and nested lists, signed by a SHA-256 over the canonical bytes
(sorted keys, no spaces, ASCII) of all other fields. The ``.npz`` is a zip of plain float64 arrays
and one uint8 array ``document``: the JSON in which ``{"array": NAME}`` stands for each of them.
Nothing in either is ever run: no pickle, no eval (numpy's own header parser is one, so the header
is matched against the one form that numpy writes), no packed entry that could grow on reading.
Source: ours; the paper names no file format.
"""

import hashlib
import io
import json
import re
import struct
import zipfile
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Set, Tuple, Union

import numpy as np

from apex_edge.errors import WeightsError
from apex_edge.record.whole import write_whole_bytes
from apex_edge.types import Array

FORMAT = "apex-edge-trigger"
FORMAT_VERSION = 2
MAX_BYTES = 8 * 1024 * 1024
"""Largest file read; the shipped ones are below 100 kB. Parsed, JSON takes up to 30 times that."""
_DOCUMENT = "document"
_MAX_ARRAYS = 256
# Shorter lists stay readable in the JSON part.
_MIN_PACKED = 32
_MAX_DIGITS = 20
_NPY = re.compile(
    rb"\x93NUMPY\x01\x00.."
    rb"\{'descr': '(?P<type><f8|\|u1)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>(?:\d{1,9}, ?)+(?:\d{1,9})?)\), \} *\n",
    re.DOTALL,
)
# What the parts of the standard library raise on bytes that are no zip and no JSON.
_UNREADABLE = (
    *(OSError, ValueError, RuntimeError, EOFError, IndexError, KeyError, OverflowError),
    *(struct.error, zipfile.BadZipFile, MemoryError),
)


def canonical_bytes(fields: Mapping[str, Any]) -> bytes:
    """Return the bytes the hash covers: all fields but ``sha256``.

    Raises
    ------
    ValueError : a number is NaN or infinite.
    """
    rest = {key: value for key, value in fields.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode("ascii")


def digest(fields: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the canonical bytes, in hex."""
    return hashlib.sha256(canonical_bytes(fields)).hexdigest()


def read(path: Union[str, Path]) -> Dict[str, Any]:
    """Return the fields of a document whose format, version and hash are right.

    Raises
    ------
    WeightsError : not there, too large, neither ``.json`` nor ``.npz``, not what its name says,
        of another format or version, changed after it was written, or a number is not finite.
    """
    source = Path(path)
    try:
        fields: Dict[str, Any] = _parsed(source.suffix, _bytes_of(source))
        found = check_identity(fields)
    except WeightsError as error:
        raise WeightsError(f"{source}: {error}") from error
    except _UNREADABLE as error:
        raise WeightsError(f"{source}: cannot be read as a model file: {error}") from error
    if fields.get("sha256") != found:
        raise WeightsError(
            f"{source}: sha256 is {fields.get('sha256')!r}, but the content gives {found!r}; "
            "the file was changed after export"
        )
    return fields


def check_identity(fields: Any) -> str:
    """Check format and version of parsed fields and return their hash."""
    if not isinstance(fields, dict):
        raise WeightsError(f"expected a JSON object, found {type(fields).__name__}")
    if fields.get("format") != FORMAT:
        raise WeightsError(f"format is {fields.get('format')!r}, expected {FORMAT!r}")
    version = fields.get("format_version")
    if version == 1:
        raise WeightsError(
            f"format_version is 1, which this program no longer reads (it reads {FORMAT_VERSION}); "
            "train and export the model again"
        )
    if type(version) is not int or version != FORMAT_VERSION:
        raise WeightsError(f"format_version is {version!r}, expected {FORMAT_VERSION}")
    return digest(fields)


def write(fields: Mapping[str, Any], path: Union[str, Path]) -> None:
    """Sign the fields and write them, whole or not at all; same fields, same bytes.

    Raises
    ------
    WeightsError : a suffix other than ``.json`` and ``.npz``, a number that is not finite, or
        more than ``MAX_BYTES``.
    RecordingError : the file cannot be written.
    """
    target = Path(path)
    try:
        # Tuples become lists here, as they will be read.
        plain = json.loads(canonical_bytes(fields).decode("ascii"))
    except (ValueError, TypeError) as error:
        raise WeightsError(f"{target}: not a document: {error}") from error
    plain["sha256"] = digest(plain)
    if target.suffix not in _FORMS:
        raise WeightsError(f"{target}: a model file ends in .json or .npz")
    data = _FORMS[target.suffix](plain)
    if len(data) > MAX_BYTES:
        raise WeightsError(
            f"{target}: {len(data)} bytes, more than the {MAX_BYTES} that are read again; "
            "a .npz takes a third of a .json"
        )
    write_whole_bytes(target, data)


def as_json(fields: Mapping[str, Any]) -> bytes:
    """Return the bytes of a ``.json``; nothing is checked."""
    return (json.dumps(fields, indent=1, sort_keys=True) + "\n").encode("ascii")


def as_npz(fields: Mapping[str, Any]) -> bytes:
    """Return the bytes of a ``.npz``; only the reserved key is checked."""
    arrays: Dict[str, Array] = {}
    text = json.dumps(_taken_out(dict(fields), "", arrays), sort_keys=True, separators=(",", ":"))
    arrays[_DOCUMENT] = np.frombuffer(text.encode("ascii"), dtype=np.uint8)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            entry = io.BytesIO()
            np.lib.format.write_array(entry, arrays[name], version=(1, 0), allow_pickle=False)
            # ZipInfo's own date is 1980: no clock in the file.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), entry.getvalue())
    return buffer.getvalue()


_FORMS = {".json": as_json, ".npz": as_npz}


def _bytes_of(source: Path) -> bytes:
    with source.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise WeightsError(f"larger than {MAX_BYTES} bytes; no model is")
    return data


def _parsed(suffix: str, data: bytes) -> Any:
    if suffix == ".json":
        return _from_json(data)
    if suffix == ".npz":
        return _unpacked(data)
    raise WeightsError("a model file ends in .json or .npz")


def _from_json(data: bytes) -> Any:
    text = data.decode("utf-8")
    return json.loads(text, parse_constant=_refuse_constant, parse_int=_short_int)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number the format allows")


def _short_int(digits: str) -> int:
    # Time to parse grows with the square of the length, and Python before 3.11 sets no limit.
    if len(digits) > _MAX_DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits is none the format allows")
    return int(digits)


def _taken_out(value: Any, name: str, arrays: Dict[str, Array]) -> Any:
    """Return a copy of ``value`` in which large lists of floats are moved to ``arrays``."""
    if isinstance(value, dict):
        if "array" in value:
            raise WeightsError(f"{name or 'document'}: the key 'array' is reserved")
        return {key: _taken_out(part, f"{name}.{key}", arrays) for key, part in value.items()}
    if not isinstance(value, list):
        return value
    shape = _float_shape(value)
    if shape is not None and _count(shape) >= _MIN_PACKED:
        key = name.strip(".")
        arrays[key] = np.array(value, dtype="<f8")
        return {"array": key}
    return [_taken_out(part, f"{name}.{row}", arrays) for row, part in enumerate(value)]


def _float_shape(value: Any) -> Optional[Tuple[int, ...]]:
    """Return the shape of nested lists of floats alike in length; None for anything else."""
    if type(value) is float:
        return ()
    if not isinstance(value, list) or not value:
        return None
    shapes = {_float_shape(part) for part in value}
    first = shapes.pop()
    return None if shapes or first is None else (len(value), *first)


def _unpacked(data: bytes) -> Any:
    arrays: Dict[str, Array] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for entry in _safe_entries(archive, len(data)):
            arrays[entry.filename[: -len(".npy")]] = _array(archive.read(entry), entry.filename)
    if _DOCUMENT not in arrays or arrays[_DOCUMENT].dtype != np.uint8:
        raise WeightsError(f"no array {_DOCUMENT!r} of bytes inside")
    fields = _from_json(arrays.pop(_DOCUMENT).tobytes())
    used: Set[str] = set()
    fields = _put_back(fields, arrays, used)
    unknown = sorted(set(arrays) - used)
    if unknown:
        raise WeightsError(f"unknown arrays {unknown}")
    return fields


def _safe_entries(archive: zipfile.ZipFile, n_bytes: int) -> List[zipfile.ZipInfo]:
    """Check the directory before anything is read: stored as they are, no more than the file."""
    entries = archive.infolist()
    names = [entry.filename for entry in entries]
    if len(entries) > _MAX_ARRAYS or len(set(names)) != len(names):
        raise WeightsError(f"{len(entries)} entries, some perhaps twice; expected few, each once")
    for entry in entries:
        if not entry.filename.endswith(".npy"):
            raise WeightsError(f"{entry.filename!r} is no array")
        if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
            raise WeightsError(f"{entry.filename!r} is compressed; model files are not")
    if sum(entry.file_size for entry in entries) > n_bytes:
        raise WeightsError("the arrays are said to be larger than the file")
    return entries


def _array(data: bytes, name: str) -> Array:
    """Return a plain array from the bytes of an ``.npy``."""
    head = _NPY.match(data)
    if head is None:
        raise WeightsError(
            f"{name!r} is not a plain array of 8-byte floats or of bytes; "
            "pickled objects and other types are refused"
        )
    shape = tuple(int(part) for part in head.group("shape").split(b",") if part.strip())
    if 0 in shape:
        # It has no bytes, and as lists (1000000000, 0) would still fill the memory.
        raise WeightsError(f"{name!r} has shape {shape}: empty arrays are refused")
    kind = np.dtype(head.group("type").decode("ascii"))
    body = data[head.end() :]
    if _count(shape) * kind.itemsize != len(body):
        raise WeightsError(f"{name!r} has {len(body)} bytes, which is not its shape {shape}")
    array: Array = np.frombuffer(body, dtype=kind).reshape(shape)
    return array


def _count(shape: Tuple[int, ...]) -> int:
    total = 1
    for length in shape:
        total *= length
    return total


def _put_back(value: Any, arrays: Mapping[str, Array], used: Set[str]) -> Any:
    if isinstance(value, list):
        return [_put_back(part, arrays, used) for part in value]
    if not isinstance(value, dict):
        return value
    if "array" not in value:
        return {key: _put_back(part, arrays, used) for key, part in value.items()}
    name = value["array"]
    if not isinstance(name, str) or len(value) != 1 or name not in arrays or name in used:
        raise WeightsError(f"{value!r} names no array of this file, or one used twice")
    used.add(name)
    array = arrays[name]
    if array.dtype != np.float64:
        raise WeightsError(f"array {name!r} is not of floats")
    return array.tolist()
