"""Shards on disk: one sealed ``NNNN.npz`` per item, a manifest, and nothing half-written.

A shard is a plain npz of arrays with fixed zip times, so the same arrays give the same bytes. Its
zip comment is a seal: the job it belongs to, its index, and the sha256 of all bytes before. A shard
whose driver died before it was written into the manifest is therefore known to be whole, and a
shard of another job is known to be foreign. Source: ours.
"""

import fcntl
import hashlib
import io
import json
import os
import re
import uuid
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Dict, Iterator, Mapping, Optional, Union

import numpy as np

from apex_edge.types import Array
from offline_train.job_key import JobError, JobKey

MANIFEST = "manifest.json"
FAILED = "failed.json"
FORMAT = "apex-edge-shards"
FORMAT_VERSION = 1
_PART = ".part"
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)
_IS_SHARD = re.compile(r"\d{4,}\.npz")


@dataclass(frozen=True)
class Manifest:
    """Content of ``manifest.json``: the ``job`` and the sha256 of each shard by file name."""

    job: Dict[str, Any]
    shards: Dict[str, str] = field(default_factory=dict)


def shard_name(index: int) -> str:
    """Return the file name of an item's shard."""
    return f"{index:04d}.npz"


def encode(arrays: Mapping[str, Array], job_sha256: str, index: int) -> bytes:
    """Return the sealed npz of named arrays: the same arrays, the same bytes.

    Raises
    ------
    TypeError, ValueError : not a mapping of names to arrays of plain numbers or text.
    """
    if not isinstance(arrays, Mapping) or not all(isinstance(name, str) for name in arrays):
        raise TypeError(f"a task returns a dict of named arrays, found {type(arrays).__name__}")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(arrays):
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asanyarray(arrays[name]), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", _ZIP_TIME)
            info.create_system = 3  # the same bytes on every system
            archive.writestr(info, member.getvalue())
        archive.comment = _seal(job_sha256, index) + b"0" * 64
    body = buffer.getvalue()[:-64]
    return body + hashlib.sha256(body).hexdigest().encode()


def sealed_sha256(path: Path, job_sha256: str, index: int) -> Optional[str]:
    """Return the sha256 of a whole shard of this job and index; None for anything else.

    Raises
    ------
    JobError : the file is there and cannot be read.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise JobError(f"{path}: cannot read: {error}") from error
    body, digest = data[:-64], data[-64:]
    is_whole = digest == hashlib.sha256(body).hexdigest().encode()
    is_ours = body.endswith(_seal(job_sha256, index))
    return hashlib.sha256(data).hexdigest() if is_whole and is_ours else None


def write_whole(path: Path, data: bytes) -> None:
    """Put a file under its name at once: temporary name, fsync, rename, fsync of the folder.

    The temporary name is nobody else's and locked while it is written, so several processes may
    write the same shard, and what a killed one left can be told from what is being written.

    Raises
    ------
    JobError : the disk is full, the folder not writable; nothing is left behind.
    """
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex}{_PART}")
    try:
        with _locked(part) as file:
            try:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
                part.replace(path)
            finally:
                with suppress(FileNotFoundError):
                    part.unlink()
        _sync_folder(path.parent)
    except OSError as error:
        raise JobError(
            f"{path}: cannot write: {error}; make room or choose another folder and run again, "
            "what is done stays done"
        ) from error


def sweep_parts(folder: Path) -> None:
    """Remove temporary files whose writer is gone; those being written are locked and stay."""
    for part in folder.glob(f".*{_PART}"):
        with suppress(FileNotFoundError, BlockingIOError), part.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            part.unlink()


def open_folder(folder: Path, key: JobKey) -> Manifest:
    """Make the folder of a job, or return what it already has; refuse that of another job.

    Raises
    ------
    JobError : not a folder, not writable, or with shards that are not of this job.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise JobError(f"{folder}: cannot make this folder: {error}") from error
    found = read_manifest(folder)
    if found is None:
        for path in folder.iterdir():
            if not _IS_SHARD.fullmatch(path.name):
                continue
            if sealed_sha256(path, key.sha256, int(path.stem)) is None:
                raise JobError(
                    f"{path}: not of this job, and {MANIFEST} is missing; choose an empty folder"
                )
        found = Manifest(key.fields())
        write_manifest(folder, found)
    elif found.job != key.fields():
        wanted = key.fields()
        other = [name for name in wanted if found.job.get(name) != wanted[name]]
        raise JobError(
            f"{folder}: holds another job (other {', '.join(other) or 'fields'}): found "
            f"{found.job}, expected {wanted}; choose another folder or delete this one"
        )
    sweep_parts(folder)
    return found


def read_manifest(folder: Path) -> Optional[Manifest]:
    """Return the manifest; None when there is none.

    Raises
    ------
    JobError : it cannot be read, or is not one.
    """
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise JobError(
            f"{path}: not a manifest: {error}; delete it and run again: whole shards are kept"
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise JobError(f"{path}: not a manifest of shards; choose another folder")
    version, job, shards = (content.get(key) for key in ("format_version", "job", "shards"))
    if version != FORMAT_VERSION:
        raise JobError(f"{path}: manifest version {version}, expected {FORMAT_VERSION}")
    if not (isinstance(job, dict) and isinstance(job.get("n_items"), int)):
        raise JobError(f"{path}: names no job")
    if not isinstance(shards, dict):
        raise JobError(f"{path}: lists no shards")
    return Manifest(job, shards)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest whole; entries that another driver has added meanwhile stay.

    Raises
    ------
    JobError : the disk refuses, or another job has taken the folder.
    """
    there = read_manifest(folder)
    if there is not None and there.job != manifest.job:
        raise JobError(f"{folder}: another job was started in this folder; choose another one")
    kept = there.shards if there is not None else {}
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "job": manifest.job,
        "shards": {**kept, **manifest.shards},
    }
    text = json.dumps(content, indent=1, sort_keys=True) + "\n"
    write_whole(folder / MANIFEST, text.encode())


def read(folder: Union[str, Path], is_partial_ok: bool = False) -> Iterator[Dict[str, Array]]:
    """Give the arrays of each shard, in the order of the items, each checked by its sha256.

    ``is_partial_ok`` leaves out items without a shard instead of refusing.

    Raises
    ------
    JobError : no manifest, an item without a shard, or a shard that is not what was written.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    if manifest is None:
        raise JobError(f"{folder / MANIFEST}: missing; this folder holds no finished job")
    for index in range(int(manifest.job["n_items"])):
        name = shard_name(index)
        if name in manifest.shards:
            yield _decode(folder / name, manifest.shards[name])
        elif not is_partial_ok:
            raise JobError(
                f"{folder / name}: missing; {FAILED} says why if it failed, else run the job again"
            )


def _decode(path: Path, sha256: str) -> Dict[str, Array]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise JobError(f"{path}: cannot read: {error}; run the job again") from error
    if hashlib.sha256(data).hexdigest() != sha256:
        raise JobError(f"{path}: not what {MANIFEST} says (sha256); run the job again")
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _seal(job_sha256: str, index: int) -> bytes:
    return f"{FORMAT} {FORMAT_VERSION} {job_sha256} {index} ".encode()


def _locked(part: Path) -> BinaryIO:
    """Open a new file and lock it; anew when a sweep took it between the two."""
    while True:
        file = part.open("xb")
        fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file.fileno()).st_nlink:
            return file
        file.close()


def _sync_folder(folder: Path) -> None:
    handle = os.open(str(folder), os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
