"""The paper's figures drawn anew with matplotlib, for reports: PNG, 200 dpi, metres, equal scales.

Laws kept here: white is free, black is occupied, grey is unknown, as in the paper; every robot has the colour that it
has everywhere, one that the colour-blind can tell from the others; nothing is shown on a screen.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from agent.paper import T_W_R, Matrix, theta_of
from agent.paper_example import SIDE, STEPS, Frame, cell_of
from agent.paper_measures import Fading
from mapping.evidence import OCCUPIED_PROBABILITY, probability
from mapping.grid import Grid
from mapping.map_picture import robot_colour
from mapping.pose import Pose

DPI = 200
_INK = "#222222"
_WALL = "#c4c4c4"
_MARGIN = 0.12
_FONT = 9.0
_SMALL = 7.5
_AXIS = 0.18
"""Metres that a drawn frame's axis is long."""


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """What one robot saw and where it went, in the common frame.

    Attributes:
        name: for the legend.
        start: its start pose, x forward.
        cloud: points, shape (P, 2), metres.
        trail: shape (N, 2), metres.
    """

    name: str
    start: Pose
    cloud: Matrix
    trail: Matrix


# --- figure 3


def figure_3(frames: Sequence[Frame]) -> bytes:
    """The example's grid at t = 1, 2, 3, with the probability in every cell and the readings as lines.

    Args:
        frames: at t = 0 ... 3.
    """
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    panels = figure.subplots(1, len(STEPS))
    for number, (axes, step, frame) in enumerate(zip(panels, STEPS, frames[1:], strict=True), start=1):
        for index, p in frame.items():
            column, row = cell_of(index)
            axes.add_patch(Rectangle((column, row), 1, 1, facecolor=str(1 - p), edgecolor="#808080", linewidth=0.8))
            ink: dict[str, Any] = {
                "color": "white" if p > 0.6 else "black",
                "path_effects": _halo(str(1 - p)),
                "zorder": 4,
            }
            axes.text(column + 0.06, row + 0.94, f"$m_{{{index}}}$", fontsize=6.5, va="top", **ink)
            axes.text(column + 0.94, row + 0.17, f"{p:.2f}", fontsize=8.0, ha="right", va="center", **ink)
        x, y = (value + 0.5 for value in cell_of(step.robot))
        for k, (reading, sensor) in enumerate(step.readings.items()):
            column, row = cell_of(reading)
            line = {"color": _hex(k), "linewidth": 1.8, "label": f"{sensor or 'reading'} on $m_{{{reading}}}$"}
            axes.plot([x, column + 0.5], [y, row + 0.5], marker="o", markersize=4, markevery=[1], **line)
        axes.plot(x, y, "s", markersize=10, color="white", markeredgecolor=_INK, label="robot")
        axes.set_title(f"({'abc'[number - 1]})  t = {number}", fontsize=_FONT + 1)
        axes.set(xlim=(0, SIDE), ylim=(0, SIDE), aspect="equal", xticks=[], yticks=[])
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=2, fontsize=_SMALL, frameon=False, handlelength=1.6
        )
    _probability_bar(figure, list(panels), r"$p(m_i = \mathrm{occupied})$")
    return _png(figure)


# --- figures 5 and 8


def cloud_figure(walls: NDArray[np.float64], tours: Sequence[Tour]) -> bytes:
    """Point clouds and trajectories over the true walls; with several robots their start frames too (eq. 8)."""
    figure, axes = _plan(walls, 1)
    _draw_walls(axes[0], walls, "true walls", colour=_WALL, width=3.0)
    for k, tour in enumerate(tours):
        colour = _hex(k)
        axes[0].plot(*tour.cloud.T, ".", markersize=3.0, color=colour, alpha=0.8, markeredgewidth=0)
        axes[0].plot(*tour.trail.T, "-", linewidth=1.6, color=colour)
        axes[0].plot(*tour.trail[0], "o", markersize=6, color="white", markeredgecolor=colour, markeredgewidth=1.6)
        axes[0].plot(*tour.trail[-1], "s", markersize=5, color=colour)
        frame = f"[R{k + 1}] = [C]" if k == 0 and len(tours) > 1 else f"[R{k + 1}]"
        _draw_frame(axes[0], tour.start, frame)
    handles = [Line2D([], [], color=_WALL, linewidth=3.0, label="true walls")]
    for k, tour in enumerate(tours):
        handles += [
            Line2D([], [], color=_hex(k), marker=".", linestyle="", markersize=5, label=f"{tour.name}: LiDAR points"),
            Line2D([], [], color=_hex(k), linewidth=1.6, label=f"{tour.name}: trajectory"),
        ]
    handles += [
        Line2D([], [], color="white", markeredgecolor=_INK, marker="o", linestyle="", markersize=6, label="start"),
        Line2D([], [], color=_INK, marker="s", linestyle="", markersize=5, label="end"),
    ]
    _legend(figure, handles, columns=2 if len(tours) == 1 else 4)
    return _png(figure)


def _draw_frame(axes: Axes, start: Pose, name: str) -> None:
    """A robot's start frame as the paper has it: x to its right, y ahead."""
    T_C_R = T_W_R(start.x, start.y, theta_of(start.yaw))

    def at(right: float, ahead: float) -> tuple[float, float]:
        x, y, _ = (T_C_R @ [right, ahead, 1]).tolist()
        return x, y

    words: dict[str, Any] = {
        "fontsize": _SMALL + 0.5,
        "ha": "center",
        "va": "center",
        "color": _INK,
        "path_effects": _halo("white"),
    }
    for tip, beside, axis in (((_AXIS, 0), (_AXIS, -0.05), "x"), ((0, _AXIS), (-0.05, _AXIS), "y")):
        arrow = {"arrowstyle": "-|>", "color": _INK, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", at(*tip), at(0, 0), arrowprops=arrow)
        axes.text(*at(*beside), axis, style="italic", **words)
    axes.text(*at(0.06, -0.10), name, **words)


def _halo(colour: str) -> list[AbstractPathEffect]:
    """What keeps words readable on a line."""
    return [withStroke(linewidth=2.2, foreground=colour)]


# --- figures 6 and 9


def grid_figure(walls: NDArray[np.float64], grids: Sequence[tuple[str, Grid]], tours: Sequence[Tour]) -> bytes:
    """Occupancy grids side by side, with the true walls as thin lines and the trajectories."""
    figure, panels = _plan(walls, len(grids))
    for axes, (title, grid) in zip(panels, grids, strict=True):
        x, y = grid.origin
        rows, columns = grid.evidence.shape
        extent = (x, x + columns * grid.lattice.cell, y, y + rows * grid.lattice.cell)
        shades = probability(grid.evidence)
        axes.imshow(shades, cmap="gray_r", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="nearest")
        axes.set_facecolor("0.5")
        _draw_walls(axes, walls, "true walls", colour="#e69f00", width=0.7)
        for k, tour in enumerate(tours):
            axes.plot(*tour.trail.T, "-", linewidth=1.1, color=_hex(k))
        _limits(axes, walls)
        axes.set_title(title, fontsize=_FONT + 1)
    _probability_bar(figure, panels, r"$p(m_i = \mathrm{occupied})$;  0.5: unknown")
    handles = [Line2D([], [], color="#e69f00", linewidth=1.2, label="true walls")]
    handles += [Line2D([], [], color=_hex(k), label=f"{tour.name}: trajectory") for k, tour in enumerate(tours)]
    _legend(figure, handles, columns=3)
    return _png(figure)


# --- the moving obstacle


def fading_figure(pipelines: Sequence[tuple[str, Fading]]) -> bytes:
    """The probability of every cell that a moving obstacle was seen in, against time."""
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    panels = figure.subplots(1, len(pipelines), sharey=True, squeeze=False)[0]
    for axes, (title, fading) in zip(panels, pipelines, strict=True):
        for cell in fading.probabilities.T:
            axes.plot(fading.seconds, cell, color="#9a9a9a", linewidth=0.7)
        axes.plot(fading.seconds, fading.probabilities.mean(axis=1), color=_hex(0), linewidth=2.0)
        axes.axhline(OCCUPIED_PROBABILITY, color=_hex(1), linewidth=1.0, linestyle="--")
        axes.set(xlabel="time since the first scan (s)", ylim=(-0.02, 1.02), xlim=(0, fading.seconds[-1]))
        axes.set_title(title, fontsize=_FONT + 1)
        _plain(axes)
    panels[0].set_ylabel(r"$p(m_i = \mathrm{occupied})$", fontsize=_FONT)
    handles = [
        Line2D([], [], color="#9a9a9a", linewidth=0.7, label="a cell in which the obstacle was seen"),
        Line2D([], [], color=_hex(0), linewidth=2.0, label="mean of these cells"),
        Line2D([], [], color=_hex(1), linewidth=1.0, linestyle="--", label=f"called occupied: {OCCUPIED_PROBABILITY}"),
    ]
    _legend(figure, handles, columns=3)
    return _png(figure)


# --- parts


def _plan(walls: NDArray[np.float64], panels: int) -> tuple[Figure, list[Axes]]:
    """A figure with room for that many plans of the space side by side, all to the same scale."""
    width, height = np.ptp(walls.reshape(-1, 2), axis=0) + 2 * _MARGIN
    inches = min(3.3, 11.0 / (panels * width), 8.0 / height)  # a metre on paper
    size = max(5.0, panels * (inches * width + 0.6) + 0.9), inches * height + 1.5
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(1, panels, sharey=True, squeeze=False)[0])
    for each in axes:
        each.set(xlabel="x (m)", aspect="equal")
        _limits(each, walls)
        for axis in (each.xaxis, each.yaxis):
            axis.set_major_locator(MultipleLocator(0.5 if max(width, height) > 2.5 else 0.25))
        _plain(each)
    axes[0].set_ylabel("y (m)")
    return figure, axes


def _limits(axes: Axes, walls: NDArray[np.float64]) -> None:
    corners = walls.reshape(-1, 2)
    (west, south), (east, north) = corners.min(axis=0) - _MARGIN, corners.max(axis=0) + _MARGIN
    axes.set(xlim=(west, east), ylim=(south, north))


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=_FONT - 1)
    axes.xaxis.label.set_fontsize(_FONT)
    axes.yaxis.label.set_fontsize(_FONT)


def _draw_walls(axes: Axes, walls: NDArray[np.float64], name: str, *, colour: str, width: float) -> None:
    axes.add_collection(
        LineCollection(list(walls.reshape(-1, 2, 2)), colors=colour, linewidths=width, label=name, capstyle="round")
    )


def _probability_bar(figure: Figure, panels: list[Axes], label: str) -> None:
    bar = figure.colorbar(ScalarMappable(cmap="gray_r"), ax=panels, fraction=0.046, pad=0.02, aspect=28)
    bar.set_label(label, fontsize=_FONT)
    bar.ax.tick_params(labelsize=_FONT - 1)


def _legend(figure: Figure, handles: list[Line2D], *, columns: int) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=_SMALL + 0.5, frameon=False)


def _hex(k: int) -> str:
    return "#{:02x}{:02x}{:02x}".format(*robot_colour(k))


def _png(figure: Figure) -> bytes:
    content = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(content, format="png", dpi=DPI, facecolor="white")
    return content.getvalue()
