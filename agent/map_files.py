"""Maps on disk: one name for every form a map has, told apart by its ending."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.errors import UserError
from agent.files import read_bytes, write_whole
from mapping.grid import Grid
from mapping.map_archive import decode_npz, encode_npz
from mapping.map_picture import Trail, grey_png, trails_png
from mapping.map_server import MapDescription, decode_description, decode_map_server, encode_map_server

_YAML = (".yaml", ".yml")


def load_map(path: Path) -> Grid:
    """Read a map.

    Args:
        path: an ``.npz``; a ``.yaml`` (its picture is found as nav2 finds it, relative to the YAML); or a ``.pgm``
            with a YAML of the same name beside it.

    Raises:
        UserError: a file is missing or damaged, or of another kind.
    """
    ending = path.suffix.lower()
    if ending == ".npz":
        data = read_bytes(path)
        try:
            return decode_npz(data)
        except ValueError as error:
            raise UserError(path, str(error), "give an npz that orion wrote") from error
    if ending in _YAML:
        description = _description(path)
        return _picture(path, description, path.parent / description.image)
    if ending == ".pgm":
        beside = [path.with_suffix(ending) for ending in _YAML]
        found = [candidate for candidate in beside if candidate.is_file()]
        if not found:
            raise UserError(path, f"has no {beside[0].name} beside it", "a PGM needs its YAML for scale and origin")
        return _picture(found[0], _description(found[0]), path)
    raise UserError(path, "is not a map", "give an .npz, a .yaml, or a .pgm with its .yaml beside it")


def load_walls(path: Path) -> NDArray[np.float64]:
    """Read true walls: a line each, ``x1,y1,x2,y2`` in metres; what follows a # is a comment.

    Returns:
        Shape (M, 4), at least one wall.

    Raises:
        UserError: the file is missing, holds no wall, or a line is not four finite numbers.
    """
    walls = []
    for number, line in enumerate(read_bytes(path).decode("utf-8-sig", "replace").splitlines(), start=1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        try:
            wall = [float(word) for word in text.split(",")]
        except ValueError:
            wall = []
        if len(wall) != 4 or not np.isfinite(wall).all():
            raise UserError(f"{path}:{number}", f"expected x1,y1,x2,y2, got {text[:60]!r}", "give four numbers, metres")
        walls.append(wall)
    if not walls:
        raise UserError(path, "holds no wall", "give lines of x1,y1,x2,y2 in metres")
    return np.array(walls, np.float64)


def save_map(folder: Path, stem: str, grid: Grid, trails: Sequence[Trail] = ()) -> dict[str, Path]:
    """Write a map in all its forms, named by ``stem``, into a folder that exists.

    Args:
        folder: see ``agent.files.prepare_folder``.
        stem: the files' common name without ending.
        grid: the map.
        trails: drawn into the PNG, which is the grey map alone if there are none.

    Returns:
        The files written, by kind: npz, pgm, yaml, png.

    Raises:
        UserError: the name is not one, or a file cannot be written.
    """
    if not stem or stem.startswith(".") or Path(stem).name != stem:
        raise UserError(stem or "name", "is no name for files", "give a name without folders")
    files = {kind: folder / f"{stem}.{kind}" for kind in ("npz", "pgm", "yaml", "png")}
    picture, description = encode_map_server(grid, files["pgm"].name)
    contents = {
        "npz": encode_npz(grid),
        "pgm": picture,
        "yaml": description,
        "png": trails_png(grid, trails) if trails else grey_png(grid),
    }
    for kind, path in files.items():
        write_whole(path, contents[kind])
    return files


def save_picture(path: Path, png: bytes) -> None:
    """Write a picture.

    Raises:
        UserError: the name does not end in .png, or the file cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise UserError(path, "is no name for a picture", "let it end in .png")
    write_whole(path, png)


def _description(path: Path) -> MapDescription:
    data = read_bytes(path)
    try:
        return decode_description(data)
    except ValueError as error:
        raise UserError(path, str(error), "see nav2's map_server for the keys") from error


def _picture(path: Path, description: MapDescription, image: Path) -> Grid:
    data = read_bytes(image)
    try:
        return decode_map_server(description, data)
    except ValueError as error:
        where = image if str(error).startswith(("picture", "not a PGM")) else path
        raise UserError(where, str(error), "mend the file") from error
