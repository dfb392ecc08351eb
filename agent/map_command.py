"""``orion map``: what can be done with map files without a swarm."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.errors import UserError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mapping.grid import Grid
    from mapping.score import Score

app = typer.Typer(
    no_args_is_help=True,
    help="Map files: export to other forms, describe, compare, score against the truth.",
)

MapFile = Annotated[
    Path, typer.Argument(metavar="MAP", help="An .npz, a map_server .yaml, or a .pgm with its .yaml beside it.")
]
Picture = Annotated[Path | None, typer.Option("--png", metavar="FILE.png", help="Draw it, too.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


def _paragraphs(text: str) -> str:
    """Help text with each paragraph on one line, for typer to wrap; one that begins with a backspace stays as it is."""
    return "\n\n".join(p if p.startswith("\b") else " ".join(p.split()) for p in text.split("\n\n"))


_EXPORT = _paragraphs("""Write a map as PNG, PGM with YAML, and npz.

The PNG is for looking at: white is free, black occupied, grey unknown. The PGM and YAML are for ROS navigation: a
cell is occupied if p > 0.65, free if p < 0.196, else unknown. The npz is the map itself, exact, with its digest.

\b
Examples:
  orion map export out/map.npz --out ros
  orion map export warehouse.yaml --out out --name truth
""")

_INFO = _paragraphs("""Describe a map, and verify the digest that an npz carries.

Known is the area of the cells with any evidence. Occupied is p > 0.65, free is p < 0.196. Two maps with the same
digest are the same, bit for bit.

\b
Examples:
  orion map info out/map.npz
  orion map info out/map.npz --json
""")

_DIFF = _paragraphs("""Compare two maps cell by cell; exit with 1 if they differ.

The maps may have different extents: what lies outside of one is unknown there. The difference is counted in units of
evidence, 0.01 nat of log-odds. In the picture a cell is orange where B has it more occupied than A, blue where more
free; the map behind is A.

\b
Examples:
  orion map diff out/map.npz out/robots/r1.npz
  orion map diff out/map.npz out/robots/r1.npz --png diff.png
""")

_SCORE = _paragraphs("""Score maps against the truth: true walls, or a true map.

A cell is occupied if p > 0.65. The truth is given in the maps' common frame.

Recall: the share of points every 1 cm along the true walls that lie within the tolerance of an occupied cell's
centre. In a true map, the points are the centres of its occupied cells that touch a free cell.

Precision: the share of the occupied cells' centres that lie within the tolerance of a true wall, or of the centre of
an occupied cell of the true map. None (null) if the map has no occupied cell.

IoU, intersection over union: both grown by the tolerance, what they share divided by what they cover together. Counted
in cells of the scored map whose centres lie within the tolerance.

Known: the area of the cells with any evidence, in square metres.

In the picture, which is of the first map, occupied cells are green if true and orange if false; what is missing of
the truth is blue.

Give several maps to see each robot's own beside the fused one. With --json, the first map's scores stand at the top
and again, with all others, under "maps".

\b
Examples:
  orion map score out/map.npz --walls walls.csv
  orion map score out/map.npz out/robots/*.npz --walls walls.csv
  orion map score out/map.npz --truth warehouse.yaml --tolerance 0.1 --json
""")


@app.command(help=_EXPORT)
def export(
    map_file: MapFile,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to; made if need be.")],
    name: Annotated[
        str | None, typer.Option("--name", metavar="STEM", help="The files' name without ending; else the map's own.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a map in all its forms."""
    from agent.files import prepare_folder
    from agent.map_files import load_map, save_map

    grid = load_map(map_file)
    stem = name if name is not None else map_file.stem
    folder = prepare_folder(out)
    if map_file.suffix.lower() != ".npz" and (folder / stem).resolve() == map_file.with_suffix("").resolve():
        raise UserError(map_file, "would be overwritten by its own export", "give another --out or --name")
    files = {kind: str(path) for kind, path in save_map(folder, stem, grid).items()}
    if as_json:
        _print_json({"files": files, "digest": grid.digest().hex()})
    else:
        _print_table(("form", "file"), list(files.items()))


@app.command(help=_INFO)
def info(map_file: MapFile, as_json: Json = False) -> None:
    """Describe a map and verify its digest."""
    import numpy as np

    from agent.map_files import load_map
    from mapping.evidence import occupied
    from mapping.map_server import free

    grid = load_map(map_file)
    rows, columns = grid.evidence.shape
    x, y = grid.origin
    verified = map_file.suffix.lower() == ".npz"  # load_map has refused a wrong one
    facts = {
        "map": str(map_file),
        "cell": grid.lattice.cell,
        "rows": rows,
        "columns": columns,
        "origin": [x, y],
        "width_m": columns * grid.lattice.cell_mm / 1000,
        "height_m": rows * grid.lattice.cell_mm / 1000,
        "known_m2": grid.known_m2,
        "known": int(np.count_nonzero(grid.evidence)),
        "occupied": int(np.count_nonzero(occupied(grid.evidence))),
        "free": int(np.count_nonzero(free(grid.evidence))),
        "tiles": len(grid.tiles()),
        "digest": grid.digest().hex(),
        "verified": verified,
    }
    if as_json:
        _print_json(facts)
        return
    _print_table(
        ("", str(map_file)),
        [
            ("cell", f"{grid.lattice.cell:g} m"),
            ("size", f"{facts['width_m']:g} x {facts['height_m']:g} m, {columns} x {rows} cells"),
            ("lower left", f"({x:g}, {y:g}) m"),
            ("known", f"{grid.known_m2:.3f} m2, {facts['known']} cells in {facts['tiles']} tiles"),
            ("occupied", f"{facts['occupied']} cells"),
            ("free", f"{facts['free']} cells"),
            ("digest", f"{facts['digest']}{' (verified)' if verified else ''}"),
        ],
    )


@app.command(help=_DIFF)
def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A map.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another map with cells of the same size.")],
    png: Picture = None,
    as_json: Json = False,
) -> None:
    """Compare two maps cell by cell."""
    from agent.map_files import load_map, save_picture
    from mapping.comparison_picture import difference_png

    grids = load_map(a), load_map(b)
    if grids[0].lattice != grids[1].lattice:
        sizes = " and ".join(f"{grid.lattice.cell:g} m" for grid in grids)
        raise UserError(b, f"the maps have cells of {sizes}", "compare maps of one cell size, or use orion map score")
    differing, largest = _difference(*grids)
    digests = [grid.digest().hex() for grid in grids]
    if png is not None:
        save_picture(png, difference_png(*grids))
    if as_json:
        _print_json({"equal": differing == 0, "differing": differing, "largest": largest, "digests": digests})
    elif differing == 0:
        typer.echo(f"equal, digest {digests[0]}")
    else:
        typer.echo(f"{differing} cells differ, by at most {largest} units of evidence")
    if differing:
        raise typer.Exit(1)


@app.command("score", help=_SCORE)
def score_maps(
    maps: Annotated[
        list[Path], typer.Argument(metavar="MAP...", help="Maps as for export; the first is the main one.")
    ],
    walls: Annotated[
        Path | None, typer.Option("--walls", metavar="CSV", help="True walls: lines of x1,y1,x2,y2 in metres.")
    ] = None,
    truth: Annotated[Path | None, typer.Option("--truth", metavar="MAP", help="A true map, of any cell size.")] = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance", metavar="M", help="Metres; 1.5 cells of each map if not given.")
    ] = None,
    png: Picture = None,
    as_json: Json = False,
) -> None:
    """Score maps against the truth."""
    from agent.map_files import load_map, load_walls, save_picture
    from mapping.comparison_picture import judgement_png
    from mapping.score import judge

    true: NDArray[np.float64] | Grid
    if walls is not None and truth is None:
        true = load_walls(walls)
    elif truth is not None and walls is None:
        true = load_map(truth)
    else:
        raise UserError("orion map score", "needs one truth", "give either --walls CSV or --truth MAP")
    rows: list[tuple[Path, Score, str]] = []
    for path in maps:
        grid = load_map(path)
        try:
            judgement = judge(grid, true, tolerance)
        except ValueError as error:
            raise UserError(path, str(error), "check frames, units and --tolerance") from error
        if png is not None and not rows:
            save_picture(png, judgement_png(grid, judgement))
        rows.append((path, judgement.score, grid.digest().hex()))
    if as_json:
        table = [{"map": str(path), **dataclasses.asdict(result), "digest": digest} for path, result, digest in rows]
        _print_json({**table[0], "truth": str(walls or truth), "maps": table})
    else:
        head = ("map", "recall", "precision", "IoU", "known m2", "tolerance m")
        _print_table(head, [(str(path), *_score_words(result)) for path, result, _ in rows])


def _score_words(result: Score) -> tuple[str, ...]:
    shares = ("-" if share is None else f"{share:.3f}" for share in (result.recall, result.precision, result.iou))
    return (*shares, f"{result.known_m2:.3f}", f"{result.tolerance:g}")


def _difference(a: Grid, b: Grid) -> tuple[int, int]:
    """The number of cells that differ, and the largest difference in units of evidence."""
    import numpy as np

    from mapping.lattice import TILE

    nothing = np.zeros((TILE, TILE), np.int32)
    tiles_a, tiles_b = a.tiles(), b.tiles()
    differing, largest = 0, 0
    for key in tiles_a.keys() | tiles_b.keys():
        # int64: the difference of two int32 need not fit one.
        gap = np.abs(tiles_a.get(key, nothing).astype(np.int64) - tiles_b.get(key, nothing))
        differing += int(np.count_nonzero(gap))
        largest = max(largest, int(gap.max()))
    return differing, largest


def _print_json(value: dict[str, object]) -> None:
    typer.echo(json.dumps(value, allow_nan=False))


def _print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A rich table on a terminal; aligned plain text, as wide as it needs, where a program or a file reads it."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if console.is_terminal:
        table = Table(*head)
        for row in rows:
            table.add_row(*(Text(word) for word in row))
        console.print(table)
        return
    widths = [max(len(line[k]) for line in (head, *rows)) for k in range(len(head))]
    for line in (head, *rows):
        typer.echo("  ".join(word.ljust(width) for word, width in zip(line, widths, strict=True)).rstrip())
