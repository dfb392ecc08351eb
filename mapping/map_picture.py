"""Pictures of a map to look at: grey as in the paper's figure 6, and with the robots' trails drawn over it.

Laws kept here: the top is north; white is free, black is occupied, grey is unknown (brightness is 1 - p); a cell is a
whole number of pixels wide.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mapping.evidence import probability
from mapping.grid import Grid
from mapping.lattice import Lattice

Colour = tuple[int, int, int]

OKABE_ITO: tuple[Colour, ...] = (
    (0, 114, 178),  # blue
    (213, 94, 0),  # vermillion
    (0, 158, 115),  # bluish green
    (204, 121, 167),  # reddish purple
    (230, 159, 0),  # orange
    (86, 180, 233),  # sky blue
    (240, 228, 66),  # yellow
)
"""Okabe and Ito's colours, which the colour-blind can tell apart (jfly.uni-koeln.de/color), darkest first."""

SHORT_SIDE = 600
"""Pixels that the shorter side of a picture has at least, unless the longer would exceed ``LONG_SIDE``."""

LONG_SIDE = 2400

_INK: Colour = (40, 40, 40)
_PAPER: Colour = (255, 255, 255)
_MARGIN = 24
_LINE = 26
_MAX_NAMES = 28
_SMOOTH = 3
"""Trails are drawn this many times larger and averaged down: Pillow's own lines are jagged."""


@dataclass(frozen=True, slots=True, eq=False)
class Trail:
    """Where a robot went.

    Attributes:
        name: for the legend.
        colour: red, green, blue, 0 to 255.
        points: metres in the common frame, shape (N, 2), finite, in the order of travel; N may be 0.

    Raises:
        ValueError: the points are not finite or not of that shape.
    """

    name: str
    colour: Colour
    points: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 2 or not np.isfinite(self.points).all():
            raise ValueError(f"trail of {self.name}: expected finite points (N, 2), got {self.points.shape}")


def robot_colour(k: int) -> Colour:
    """The colour of the k-th robot of the roster; the eighth has the first's again."""
    return OKABE_ITO[k % len(OKABE_ITO)]


def grey_png(grid: Grid) -> bytes:
    """The map alone as a grey PNG, every cell a square of pixels; an empty map is one unknown cell."""
    return _png(_upscaled(grid)[0])


def trails_png(grid: Grid, trails: Sequence[Trail]) -> bytes:
    """The map as a colour PNG with the robots' trails, a scale bar and a legend.

    A ring marks where a trail starts, a square where it ends. Beyond 28 robots the legend only counts them.
    """
    picture, pixels_per_cell = _upscaled(grid)
    drawn = picture.convert("RGB")
    _draw_trails(drawn, _Scale.of(grid, pixels_per_cell), trails)
    entries = [(trail.name, trail.colour) for trail in trails]
    marks = "    ring: start, square: end" if trails else ""
    return _page(drawn, pixels_per_cell / grid.lattice.cell, entries, marks)


def cells_png(colours: NDArray[np.uint8], lattice: Lattice, entries: Sequence[tuple[str, Colour]]) -> bytes:
    """Cells in colours of their own, with a scale bar and a legend.

    Args:
        colours: shape (rows, columns, 3), at least one cell; row 0 is north.
        lattice: the cells' size.
        entries: what the colours mean.
    """
    drawn, pixels_per_cell = _enlarged(colours)
    return _page(drawn, pixels_per_cell / lattice.cell, entries)


def _page(drawn: Image.Image, pixels_per_metre: float, entries: Sequence[tuple[str, Colour]], marks: str = "") -> bytes:
    """A framed picture with its legend below."""
    legend = _legend(drawn.width, pixels_per_metre, entries, marks)
    page = Image.new("RGB", (drawn.width + 2 * _MARGIN, drawn.height + legend.height + 2 * _MARGIN), _PAPER)
    page.paste(legend, (_MARGIN, _MARGIN + drawn.height))
    frame = (_MARGIN - 1, _MARGIN - 1, _MARGIN + drawn.width, _MARGIN + drawn.height)
    ImageDraw.Draw(page).rectangle(frame, outline=_INK)
    page.paste(drawn, (_MARGIN, _MARGIN))
    return _png(page)


def brightness(grid: Grid) -> NDArray[np.uint8]:
    """255 * (1 - p) of every cell, shape (rows, columns), row 0 is north; unknown is 128."""
    # Rounded half up, so that unknown, 127.5, is the same everywhere.
    return np.floor(255 * (1 - probability(grid.evidence[::-1])) + 0.5).astype(np.uint8)


def _upscaled(grid: Grid) -> tuple[Image.Image, int]:
    """The grey picture and how many pixels wide a cell is."""
    return _enlarged(brightness(grid) if grid.evidence.size else np.full((1, 1), 128, np.uint8))


def _enlarged(cells: NDArray[np.uint8]) -> tuple[Image.Image, int]:
    """Cells as squares of pixels, and how many pixels wide one is."""
    short, long = sorted(cells.shape[:2])
    pixels_per_cell = max(1, min(math.ceil(SHORT_SIDE / short), LONG_SIDE // long))
    return Image.fromarray(cells.repeat(pixels_per_cell, axis=0).repeat(pixels_per_cell, axis=1)), pixels_per_cell


def _png(picture: Image.Image) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


@dataclass(frozen=True, slots=True)
class _Scale:
    """From metres in the common frame to pixels of the map's picture."""

    left: float
    top: float
    pixels_per_metre: float

    @classmethod
    def of(cls, grid: Grid, pixels_per_cell: int) -> _Scale:
        x, y = grid.origin
        return cls(x, y + max(1, len(grid.evidence)) * grid.lattice.cell, pixels_per_cell / grid.lattice.cell)

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return (points - (self.left, self.top)) * (self.pixels_per_metre, -self.pixels_per_metre)


def _draw_trails(picture: Image.Image, scale: _Scale, trails: Sequence[Trail]) -> None:
    """Draw over the map, each trail with a thin white edge that sets it off from walls and from other trails."""
    smooth = _SMOOTH if picture.width * picture.height <= LONG_SIDE**2 else 1
    sheet = picture.resize((picture.width * smooth, picture.height * smooth), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(sheet)
    unit = smooth * max(1.0, min(picture.size) / SHORT_SIDE)
    paths = [(scale.pixels(trail.points) * smooth, trail.colour) for trail in trails if len(trail.points)]
    for path, colour in paths:
        _draw_line(draw, path, 4.4 * unit, _PAPER)
        _draw_line(draw, path, 2.6 * unit, colour)
    # The marks of all come last: nobody's line hides where another starts.
    for path, colour in paths:
        for (x, y), square in zip(path[[0, -1]], (False, True), strict=True):
            for radius, fill in ((7.5 * unit, _PAPER), (6 * unit, colour)):
                (draw.rectangle if square else draw.ellipse)((x - radius, y - radius, x + radius, y + radius), fill)
            if not square:
                draw.ellipse((x - 3 * unit, y - 3 * unit, x + 3 * unit, y + 3 * unit), _PAPER)
    picture.paste(sheet.reduce(smooth) if smooth > 1 else sheet)


def _draw_line(draw: ImageDraw.ImageDraw, path: NDArray[np.float64], width: float, colour: Colour) -> None:
    draw.line([(x, y) for x, y in path.tolist()], colour, round(width), joint="curve")


def _legend(width: int, pixels_per_metre: float, named: Sequence[tuple[str, Colour]], marks: str) -> Image.Image:
    """A strip as wide as the map: the scale bar, then names with their colours, as many lines as they need."""
    font = ImageFont.load_default(15)
    strip = Image.new("RGB", (width, _LINE * (len(named) + 3)), _PAPER)
    draw = ImageDraw.Draw(strip)
    metres = _round_length(width / 4 / pixels_per_metre)
    bar, line = metres * pixels_per_metre, 1.4 * _LINE
    draw.line([(1, line - 5), (1, line), (bar, line), (bar, line - 5)], _INK, 2)
    draw.text((bar + 10, line), f"{metres:g} m{marks}", _INK, font, anchor="lm")
    x, line = 0.0, line + 1.2 * _LINE
    entries: list[tuple[str, Colour | None]] = [(_printable(name), colour) for name, colour in named[:_MAX_NAMES]]
    if len(named) > _MAX_NAMES:
        entries.append((f"and {len(named) - _MAX_NAMES} more", None))
    for name, colour in entries:
        needed = 34 + draw.textlength(name, font) + 22
        if x > 0 and x + needed > width:
            x, line = 0.0, line + _LINE
        if colour is not None:
            draw.line([(x, line), (x + 24, line)], colour, 6)
        draw.text((x + 34, line), name, _INK, font, anchor="lm")
        x += needed
    return strip.crop((0, 0, width, math.ceil(line + (_LINE / 2 if entries else -_LINE / 2))))


def _round_length(at_most: float) -> float:
    """The longest of 1, 2, 5, 10, 20, ... (or 0.5, 0.2, 0.1, ...) that is not longer."""
    decade = 10.0 ** math.floor(math.log10(at_most))
    return max(decade * step for step in (1, 2, 5) if decade * step <= at_most * (1 + 1e-9))


def _printable(name: str) -> str:
    """One line of at most 24 characters that a font can be asked for."""
    plain = "".join(c if c.isprintable() else "?" for c in name)
    return plain if len(plain) <= 24 else plain[:21] + "..."
