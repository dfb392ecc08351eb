// What happened when: the known area and the traffic, over the time that the observer remembers.

import uPlot from "uplot";
import { $, bytes } from "./dom";
import type { Store } from "./store";

export class Charts {
  private readonly area: uPlot;
  private readonly traffic: uPlot;
  private drawn = 0;
  private at: number | null = null; // of a log: the time that is shown

  constructor(private readonly store: Store) {
    this.area = chart($("area"), "known", (value) => `${value.toFixed(value < 10 ? 1 : 0)} m²`, () => this.at);
    this.traffic = chart($("traffic"), "heard", (value) => bytes(value), () => this.at);
    new ResizeObserver(() => this.resize()).observe($("charts"));
  }

  update(): void {
    const rows = this.store.history;
    const at = this.store.state?.timeline?.seconds ?? null;
    if (rows.length === this.drawn && at === this.at) return;
    [this.drawn, this.at] = [rows.length, at];
    const times = rows.map((row) => row[0]);
    this.area.setData([times, rows.map((row) => row[1])]);
    this.traffic.setData([times, rows.map((row) => row[2])]);
  }

  /** The colours are others now. */
  redraw(): void {
    this.area.redraw(false, true);
    this.traffic.redraw(false, true);
  }

  private resize(): void {
    const width = Math.max(120, $("area").clientWidth);
    for (const plot of [this.area, this.traffic]) plot.setSize({ width, height: 96 });
  }
}

function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function chart(into: HTMLElement, label: string, words: (value: number) => string, at: () => number | null): uPlot {
  const axis = { stroke: () => colour("--dim"), font: "11px system-ui", ticks: { show: false } };
  const grid = { stroke: () => colour("--line"), width: 1 };
  return new uPlot(
    {
      width: Math.max(120, into.clientWidth),
      height: 96,
      legend: { show: false },
      cursor: { y: false, points: { size: 6 } },
      scales: { x: { time: false }, y: { range: (_, low, high) => [Math.min(0, low), Math.max(high, 1e-9) * 1.08] } },
      series: [
        {},
        { label, stroke: () => colour("--accent"), width: 1.75, fill: () => colour("--accent-faint"), points: { show: false } },
      ],
      axes: [
        { ...axis, grid: { show: false }, size: 22, values: (_, ticks) => ticks.map((tick) => (tick < 120 ? `${tick} s` : `${Math.round(tick / 6) / 10} min`)) },
        { ...axis, grid, size: 58, space: 28, values: (_, ticks) => ticks.map(words) },
      ],
      hooks: {
        draw: [
          ({ ctx, bbox, valToPos }) => {
            const seconds = at();
            if (seconds === null) return;
            ctx.fillStyle = colour("--ink");
            ctx.fillRect(Math.round(valToPos(seconds, "x", true)), bbox.top, devicePixelRatio, bbox.height);
          },
        ],
      },
    },
    [[], []],
    into,
  );
}
