"""What a diagnosis was made from: the version of the package, the hashes of what was read, the fleet it was judged beside."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from ..paths import package_version
from .diagnosis import Diagnosis
from .fleet_file import Fleet

__all__ = ["with_provenance"]


def with_provenance(diagnosis: Diagnosis, paths: Sequence[Path] = (), fleet: Fleet | None = None) -> Diagnosis:
    """The diagnosis that says so.

    Parameters
    ----------
    diagnosis : Diagnosis
    paths : sequence of Path
        Files and folders that were read; none where the node itself recorded.
    fleet : Fleet, optional
        As it was read from its file.
    """
    inputs = [{"name": path.name, "sha256": _sha256(path)} for path in paths]
    read: dict[str, object] = {"package_version": package_version(), "inputs": inputs}
    if fleet is not None:
        read["fleet"] = {"name": fleet.name, "sha256": fleet.sha256}
    return replace(diagnosis, provenance={**diagnosis.provenance, **read})


def _sha256(path: Path) -> str:
    """Of a file, or of the files of a folder in the order of their names."""
    digest = hashlib.sha256()
    for file in _files(path):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _files(path: Path) -> Iterator[Path]:
    if path.is_dir():
        yield from sorted(file for file in path.rglob("*") if file.is_file())
    else:
        yield path
