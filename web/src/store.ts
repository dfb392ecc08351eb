// All that has come in, and what is derived from it tile by tile: who saw a cell most, and where robots contradict.

import { int16, int32 } from "./feed";
import { CELLS, type Source, TILE, type Tiles, greatest, keyOf, occupiedWins, placeOf, pyramid } from "./pyramid";
import { FUSED, type Frame, type Session, type State } from "./state";

export interface Track {
  trail: number[][]; // x_mm, y_mm, yaw_turn16
  hits: number[][]; // x_mm, y_mm
  hitsInAll: number;
}

export const OCCUPIED = 62; // units of evidence: p > 0.65, as in mapping/evidence.py
export const SEEN_OCCUPIED = 16384;
export const SEEN_BY_SEVERAL = 8192;
const MOST_HITS = 2000; // as in agent/page_tracks.py

export class Store {
  state: State | null = null;
  layers = new Map<string, Tiles>();
  tracks = new Map<string, Track>();
  history: [number, number, number][] = [];
  /** Tiles of the map of which only a coarser level has come. */
  private readonly coarse = new Set<number>();
  /** Tiles that changed since somebody last looked, by layer. */
  changed = new Map<string, Set<number>>();

  /** Forget everything: the server says it all again. */
  clear(): void {
    for (const layer of this.layers.keys()) this.noteAll(layer);
    this.layers.clear();
    this.coarse.clear();
    this.tracks.clear();
    this.history = [];
  }

  take(frame: Frame): void {
    for (const [layer, level, keys, cells] of frame.tiles ?? []) {
      const places = int32(keys);
      const values = int16(cells);
      const size = CELLS >> (2 * level);
      const tiles = this.layers.get(layer) ?? new Map<number, Int16Array>();
      this.layers.set(layer, tiles);
      const note = this.note(layer);
      for (let k = 0; k < places.length / 2; k++) {
        const key = keyOf(places[2 * k], places[2 * k + 1]);
        const tile = values.subarray(k * size, (k + 1) * size);
        tiles.set(key, level === 0 ? tile : pyramid(tile, occupiedWins, level));
        note.add(key);
        if (layer === FUSED) this.coarse[level === 0 ? "delete" : "add"](key);
      }
    }
    for (const [layer, first, trail, firstHit, hits] of frame.tracks ?? []) {
      const track = this.tracks.get(layer) ?? { trail: [], hits: [], hitsInAll: 0 };
      this.tracks.set(layer, track);
      track.trail.length = Math.min(track.trail.length, first);
      const poses = int32(trail);
      for (let k = 0; k < poses.length; k += 3) track.trail.push([poses[k], poses[k + 1], poses[k + 2]]);
      if (firstHit !== track.hitsInAll) track.hits = [];
      const points = int32(hits);
      for (let k = 0; k < points.length; k += 2) track.hits.push([points[k], points[k + 1]]);
      track.hitsInAll = firstHit + points.length / 2;
      if (track.hits.length > MOST_HITS) track.hits.splice(0, track.hits.length - MOST_HITS);
    }
    for (const row of frame.history ?? []) this.history.push(row);
    if (frame.state) {
      this.state = frame.state;
      const held = new Set([FUSED, ...this.sessions.map((each) => each.session)]);
      for (const layer of this.layers.keys()) {
        if (held.has(layer)) continue;
        this.noteAll(layer);
        this.layers.delete(layer);
      }
      for (const layer of this.tracks.keys()) if (!held.has(layer)) this.tracks.delete(layer);
    }
  }

  /** Whether every cell of the map is here. */
  get exact(): boolean {
    return this.tiles(FUSED).size > 0 && this.tiles(FUSED).size >= (this.state?.tiles ?? Infinity) && this.coarse.size === 0;
  }

  tiles(layer: string): Tiles {
    return this.layers.get(layer) ?? NONE;
  }

  /** A layer as it will be whenever it is asked, whatever becomes of the connection meanwhile. */
  source(layer: string): Source {
    return {
      get: (key) => pooled(this.tiles(layer), key),
      keys: () => this.tiles(layer).keys(),
      size: () => this.tiles(layer).size,
    };
  }

  /** The sessions that are held, in the server's order. */
  get sessions(): Session[] {
    return this.state?.sessions.filter((each) => !each.replaced) ?? [];
  }

  get summed(): Session[] {
    return this.sessions.filter((each) => each.summed);
  }

  evidence(layer: string, i: number, j: number): number {
    const tile = this.tiles(layer).get(keyOf(Math.floor(j / TILE), Math.floor(i / TILE)));
    return tile ? tile[(j & (TILE - 1)) * TILE + (i & (TILE - 1))] : 0;
  }

  private note(layer: string): Set<number> {
    let keys = this.changed.get(layer);
    if (!keys) this.changed.set(layer, (keys = new Set()));
    return keys;
  }

  private noteAll(layer: string): void {
    const keys = this.note(layer);
    for (const key of this.tiles(layer).keys()) keys.add(key);
  }
}

const NONE: Tiles = new Map();

/** A tile with its pyramid, which is made when somebody looks. */
function pooled(tiles: Tiles, key: number): Int16Array | undefined {
  const cells = tiles.get(key);
  if (cells?.length !== CELLS) return cells;
  const all = pyramid(cells, occupiedWins);
  tiles.set(key, all);
  return all;
}

/**
 * Where robots contradict each other, 0 to 1000 a cell: 1 - |sum| / sum of |.| over the sessions in the map, in
 * thousandths; 0 where either side is weaker than one clear hit. Around every wall there is a little of it; a robot
 * that was started elsewhere than it believes shows as whole walls.
 */
export function contested(store: Store, key: number): Int16Array | undefined {
  const tiles = store.summed.flatMap((each) => store.tiles(each.session).get(key) ?? []);
  if (tiles.length < 2) return undefined;
  const clear = store.state?.clear_hit ?? 85;
  const cells = new Int16Array(CELLS);
  for (let k = 0; k < CELLS; k++) {
    let occupied = 0;
    let free = 0;
    for (const tile of tiles) {
      if (tile[k] > 0) occupied += tile[k];
      else free -= tile[k];
    }
    if (Math.min(occupied, free) >= clear) cells[k] = Math.round((2000 * Math.min(occupied, free)) / (occupied + free));
  }
  return pyramid(cells, greatest);
}

/** Who saw each cell most: 1 + the index among the held sessions, and flags for occupied and for several witnesses. */
export function witnessed(store: Store, key: number): Int16Array | undefined {
  const sessions = store.sessions;
  const tiles = sessions.map((each) => (each.summed ? store.tiles(each.session).get(key) : undefined));
  if (tiles.every((tile) => tile === undefined)) return undefined;
  const fused = store.tiles(FUSED).get(key);
  const cells = new Int16Array(CELLS);
  for (let k = 0; k < CELLS; k++) {
    let most = 0;
    let who = 0;
    let witnesses = 0;
    tiles.forEach((tile, index) => {
      const weight = tile ? Math.abs(tile[k]) : 0;
      if (weight > 0) witnesses++;
      if (weight > most) {
        most = weight;
        who = index + 1;
      }
    });
    if (who === 0) continue;
    cells[k] = who + (witnesses > 1 ? SEEN_BY_SEVERAL : 0) + ((fused?.[k] ?? 0) > OCCUPIED ? SEEN_OCCUPIED : 0);
  }
  return pyramid(cells, greatest);
}

/** The map without one session: what it is compared with while it is moved. */
export function without(store: Store, session: string, key: number): Int16Array | undefined {
  const fused = store.tiles(FUSED).get(key);
  const own = store.tiles(session).get(key);
  if (!fused || !own) return fused;
  return pyramid(fused.subarray(0, CELLS).map((value, k) => value - own[k]), occupiedWins);
}

/** The box of cells around some tiles: i0, j0, columns, rows. */
export function bounds(tiles: Tiles): [number, number, number, number] | null {
  let [west, south, east, north] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [key, cells] of tiles) {
    if (!cells.some((value) => value !== 0)) continue;
    const [ty, tx] = placeOf(key);
    west = Math.min(west, tx);
    east = Math.max(east, tx + 1);
    south = Math.min(south, ty);
    north = Math.max(north, ty + 1);
  }
  return west < east ? [west * TILE, south * TILE, (east - west) * TILE, (north - south) * TILE] : null;
}
