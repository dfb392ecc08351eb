// Canvases over a Leaflet map: one canvas pixel is a cell, or 2, 4 ... 32 of them pooled when one zooms out.
// They are painted tile by tile for a few milliseconds of each frame on the screen, so that nothing else has to wait.

import * as L from "leaflet";
import type { Table } from "./palette";
import { LEVELS, OFFSET, type Source, TILE, keyOf, placeOf } from "./pyramid";

const BLOCK = 256;
const BUDGET = 10; // milliseconds of each frame
export const MIN_NATIVE_ZOOM = -(LEVELS - 1);

/** One canvas and what is to be painted on it. */
interface Block {
  context: CanvasRenderingContext2D;
  coords: L.Coords;
  image: ImageData;
  pixels: Uint32Array;
  tiles: Set<number>; // those to be painted
  all: boolean; // everything else on it is to go first
}

export class TileLayer extends L.GridLayer {
  private source: Source = { get: () => undefined, keys: () => [], size: () => 0 };
  private table: Table = new Uint32Array(65536);
  private readonly blocks = new Map<string, Block>();
  private readonly stale = new Set<Block>();

  constructor(options: L.GridLayerOptions = {}) {
    super({
      tileSize: BLOCK,
      minNativeZoom: MIN_NATIVE_ZOOM,
      maxNativeZoom: 0,
      minZoom: -8,
      maxZoom: 6,
      noWrap: true,
      keepBuffer: 1,
      updateWhenZooming: false,
      updateInterval: 60,
      ...options,
    });
    this.on("tileunload", (event) => {
      const name = nameOf((event as L.TileEvent).coords);
      const block = this.blocks.get(name);
      this.blocks.delete(name);
      if (block) this.stale.delete(block);
    });
  }

  /** Draw something else, or in other colours. */
  show(source: Source, table: Table): void {
    this.source = source;
    this.table = table;
    for (const block of this.blocks.values()) this.renew(block);
  }

  override createTile(coords: L.Coords): HTMLElement {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = BLOCK;
    canvas.className = "cells";
    canvas.dataset.block = nameOf(coords);
    const image = new ImageData(BLOCK, BLOCK);
    const block = { context: canvas.getContext("2d")!, coords, image, pixels: new Uint32Array(image.data.buffer), tiles: new Set<number>(), all: true };
    this.blocks.set(nameOf(coords), block);
    this.renew(block);
    return canvas;
  }

  /** Draw some tiles again. */
  refresh(keys: Iterable<number>): void {
    const levels = new Set([...this.blocks.values()].map((block) => -block.coords.z));
    for (const key of keys) {
      const [ty, tx] = placeOf(key);
      for (const level of levels) {
        const across = BLOCK / (TILE >> level);
        const coords = { x: Math.floor(tx / across), y: Math.floor(-(ty + 1) / across), z: -level };
        const block = this.blocks.get(nameOf(coords));
        if (!block) continue;
        block.tiles.add(key);
        this.stale.add(block);
      }
    }
    wantPainting(this);
  }

  /** Paint what is to be painted; gives whether all of it was done in time. */
  paint(until: number): boolean {
    for (const block of this.stale) {
      if (block.all) {
        block.all = false;
        block.pixels.fill(this.table[0]);
      }
      for (const key of block.tiles) {
        if (performance.now() > until) return false;
        block.tiles.delete(key);
        this.fill(block, key);
      }
      block.context.putImageData(block.image, 0, 0);
      this.stale.delete(block);
    }
    return true;
  }

  private renew(block: Block): void {
    const { x, y, z } = block.coords;
    const across = BLOCK / (TILE >> -z);
    const [tx0, ty1] = [x * across, -y * across - 1]; // the tile in the upper left corner
    block.all = true;
    block.tiles.clear();
    if (this.source.size() < across * across) {
      for (const key of this.source.keys()) {
        const [ty, tx] = placeOf(key);
        if (tx >= tx0 && tx < tx0 + across && ty <= ty1 && ty > ty1 - across) block.tiles.add(key);
      }
    } else {
      for (let ty = ty1; ty > ty1 - across; ty--) {
        for (let tx = tx0; tx < tx0 + across; tx++) block.tiles.add(keyOf(ty, tx));
      }
    }
    this.stale.add(block);
    wantPainting(this);
  }

  /** One tile's pixels: its row 0 is south, the canvas's is north. */
  private fill({ coords, pixels }: Block, key: number): void {
    const [ty, tx] = placeOf(key);
    const level = -coords.z;
    const side = TILE >> level;
    const [left, top] = [tx * side - coords.x * BLOCK, -(ty + 1) * side - coords.y * BLOCK];
    const cells = this.source.get(key);
    for (let row = 0; row < side; row++) {
      let from = OFFSET[level] + (side - 1 - row) * side;
      let to = (top + row) * BLOCK + left;
      for (let column = 0; column < side; column++) pixels[to++] = this.table[(cells ? cells[from++] : 0) & 0xffff];
    }
  }
}

// --- all layers take turns

const waiting = new Set<TileLayer>();
let asked = false;

function wantPainting(layer: TileLayer): void {
  waiting.add(layer);
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    const until = performance.now() + BUDGET;
    for (const each of waiting) {
      if (each.paint(until)) waiting.delete(each);
      else wantPainting(each);
    }
  });
}

function nameOf({ x, y, z }: Pick<L.Coords, "x" | "y" | "z">): string {
  return `${x},${y},${z}`;
}
