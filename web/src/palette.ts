// From evidence to colours: tables of 65,536 RGBA pixels, one entry for each int16, so that drawing is a look-up.

import { SEEN_BY_SEVERAL, SEEN_OCCUPIED } from "./store";

export type Rgb = [number, number, number];
export type Table = Uint32Array;

/** What the page's own colours are; the map sits between them. */
export interface Paper {
  unknown: Rgb;
  free: Rgb;
  occupied: Rgb;
}

export const LIGHT: Paper = { unknown: [223, 228, 234], free: [255, 255, 255], occupied: [23, 32, 43] };
export const DARK: Paper = { unknown: [16, 21, 27], free: [56, 68, 82], occupied: [244, 247, 250] };

const VIRIDIS = ["440154", "482475", "414487", "355f8d", "2a788e", "21918c", "22a884", "44bf70", "7ad151", "bddf26", "fde725"];
const CIVIDIS = ["00224e", "123570", "3b496c", "575d6d", "707173", "8a8678", "a59c74", "c3b369", "e1cc55", "fee838"];

export const PALETTES = {
  paper: "Paper",
  grey: "Grey, as in map.png",
  cividis: "Cividis",
  viridis: "Viridis",
} as const;
export type PaletteName = keyof typeof PALETTES;

export function rgb(hex: string): Rgb {
  const value = parseInt(hex.replace("#", ""), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

export function css([r, g, b]: Rgb): string {
  return `rgb(${Math.round(r)} ${Math.round(g)} ${Math.round(b)})`;
}

export function mix(a: Rgb, b: Rgb, t: number): Rgb {
  return [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t];
}

export function ramp(stops: string[], t: number): Rgb {
  const at = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
  const k = Math.min(Math.floor(at), stops.length - 2);
  return mix(rgb(stops[k]), rgb(stops[k + 1]), at - k);
}

/** Eq. 7: p = 1 - 1 / (1 + exp l), of evidence in units of 0.01 nat. */
export function probability(evidence: number): number {
  return 1 - 1 / (1 + Math.exp(evidence / 100));
}

function pixel([r, g, b]: Rgb, alpha = 1): number {
  return (
    ((Math.round(alpha * 255) << 24) | (Math.round(b) << 16) | (Math.round(g) << 8) | Math.round(r)) >>> 0
  );
}

function table(colour: (value: number) => number): Table {
  const all = new Uint32Array(65536);
  for (let value = -32768; value < 32768; value++) all[value & 0xffff] = colour(value);
  return all;
}

export function shade(palette: PaletteName, paper: Paper, p: number): Rgb {
  switch (palette) {
    case "grey": {
      const level = Math.floor(255 * (1 - p) + 0.5); // as mapping/map_picture.py rounds it
      return [level, level, level];
    }
    case "cividis":
      return ramp(CIVIDIS, p);
    case "viridis":
      return ramp(VIRIDIS, p);
    case "paper":
      return p > 0.5 ? mix(paper.unknown, paper.occupied, 2 * p - 1) : mix(paper.unknown, paper.free, 1 - 2 * p);
  }
}

/** The map; unknown cells show the paper. */
export function mapTable(palette: PaletteName, paper: Paper): Table {
  return table((value) => (value === 0 && palette !== "grey" ? 0 : pixel(shade(palette, paper, probability(value)))));
}

/** How sure the map is: |l| on a logarithmic scale, up to `SUREST`. */
export const SUREST = 3000;

export function certainty(evidence: number): number {
  return Math.log1p(Math.abs(evidence) / 40) / Math.log1p(SUREST / 40);
}

export function confidenceTable(): Table {
  return table((value) => (value === 0 ? 0 : pixel(ramp(VIRIDIS, certainty(value)))));
}

export function confidenceRamp(t: number): Rgb {
  return ramp(VIRIDIS, t);
}

/** A map that steps back behind something else. */
export function faintTable(paper: Paper): Table {
  return table((value) => {
    if (value === 0) return 0;
    const p = probability(value);
    const strong = p > 0.5 ? mix(paper.unknown, paper.occupied, 0.42 * (2 * p - 1)) : mix(paper.unknown, paper.free, 1 - 2 * p);
    return pixel(strong);
  });
}

export function contestedColour(t: number): Rgb {
  return mix([240, 180, 40], [200, 40, 20], t);
}

/** Disagreement in thousandths. */
export function contestedTable(): Table {
  return table((value) => (value <= 0 ? 0 : pixel(contestedColour(value / 1000), 0.55 + 0.45 * (value / 1000))));
}

/** One robot's own map: its hits in its colour, what it saw free tinted with it. */
export function robotTable(colour: Rgb): Table {
  return table((value) => {
    if (value === 0) return 0;
    const p = probability(value);
    return p > 0.5 ? pixel(colour, 2 * p - 1) : pixel(colour, 0.28 * (1 - 2 * p));
  });
}

/** Who saw it: the colour of the robot that saw it most; paler where several did. */
export function witnessTable(colours: Rgb[], paper: Paper): Table {
  return table((value) => {
    if (value <= 0) return 0;
    const colour = colours[(value & (SEEN_BY_SEVERAL - 1)) - 1];
    if (!colour) return 0;
    if (value & SEEN_OCCUPIED) return pixel(mix(colour, paper.occupied, 0.55));
    return pixel(mix(colour, paper.free, value & SEEN_BY_SEVERAL ? 0.62 : 0.3));
  });
}
