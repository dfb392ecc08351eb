// Canvases over a Leaflet map: one canvas pixel is a cell, or 2, 4 ... 32 of them pooled when one zooms out.

import * as L from "leaflet";
import { LEVELS, OFFSET, type Source, TILE, keyOf, placeOf } from "./pyramid";
import type { Table } from "./palette";

const BLOCK = 256;
const MANY = 128; // tiles for which it is quicker to draw everything
export const MIN_NATIVE_ZOOM = -(LEVELS - 1);

export class TileLayer extends L.GridLayer {
  private source: Source = { get: () => undefined, keys: () => [], size: () => 0 };
  private table: Table = new Uint32Array(65536);
  private readonly canvases = new Map<string, HTMLCanvasElement>();

  constructor(options: L.GridLayerOptions = {}) {
    super({
      tileSize: BLOCK,
      minNativeZoom: MIN_NATIVE_ZOOM,
      maxNativeZoom: 0,
      minZoom: -8,
      maxZoom: 6,
      noWrap: true,
      keepBuffer: 3,
      updateWhenZooming: false,
      updateInterval: 60,
      ...options,
    });
    this.on("tileunload", (event) => this.canvases.delete(name((event as L.TileEvent).coords)));
  }

  /** Draw something else, or in other colours. */
  show(source: Source, table: Table): void {
    this.source = source;
    this.table = table;
    for (const [block, canvas] of this.canvases) this.paint(canvas, ...parse(block));
  }

  override createTile(coords: L.Coords): HTMLElement {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = BLOCK;
    canvas.className = "cells";
    canvas.dataset.block = name(coords);
    this.canvases.set(name(coords), canvas);
    this.paint(canvas, coords.x, coords.y, coords.z);
    return canvas;
  }

  /** Draw some tiles again. */
  refresh(keys: ReadonlySet<number>): void {
    if (keys.size > MANY) {
      this.show(this.source, this.table);
      return;
    }
    for (const key of keys) {
      const [ty, tx] = placeOf(key);
      for (const [block, canvas] of this.canvases) {
        const [x, y, z] = parse(block);
        const side = TILE >> -z;
        const left = tx * side - x * BLOCK;
        const top = -(ty + 1) * side - y * BLOCK;
        if (left < 0 || top < 0 || left >= BLOCK || top >= BLOCK) continue;
        const image = new ImageData(side, side);
        this.fill(new Uint32Array(image.data.buffer), side, this.source.get(key), -z, 0, 0);
        canvas.getContext("2d")!.putImageData(image, left, top);
      }
    }
  }

  private paint(canvas: HTMLCanvasElement, x: number, y: number, z: number): void {
    const level = -z;
    const side = TILE >> level;
    const image = new ImageData(BLOCK, BLOCK);
    const pixels = new Uint32Array(image.data.buffer);
    const across = BLOCK / side;
    const [tx0, ty1] = [x * across, -y * across - 1]; // the tile in the canvas's upper left corner
    const draw = (key: number, tx: number, ty: number): void => {
      const cells = this.source.get(key);
      if (cells) this.fill(pixels, BLOCK, cells, level, (tx - tx0) * side, (ty1 - ty) * side);
    };
    if (this.source.size() < across * across) {
      for (const key of this.source.keys()) {
        const [ty, tx] = placeOf(key);
        if (tx >= tx0 && tx < tx0 + across && ty <= ty1 && ty > ty1 - across) draw(key, tx, ty);
      }
    } else {
      for (let ty = ty1; ty > ty1 - across; ty--) {
        for (let tx = tx0; tx < tx0 + across; tx++) draw(keyOf(ty, tx), tx, ty);
      }
    }
    if (this.table[0] !== 0) {
      const unknown = this.table[0];
      for (let k = 0; k < pixels.length; k++) if (pixels[k] === 0) pixels[k] = unknown;
    }
    canvas.getContext("2d")!.putImageData(image, 0, 0);
  }

  /** One tile's pixels: its row 0 is south, the canvas's is north. */
  private fill(pixels: Uint32Array, width: number, cells: Int16Array | undefined, level: number, left: number, top: number): void {
    const side = TILE >> level;
    for (let row = 0; row < side; row++) {
      let from = OFFSET[level] + (side - 1 - row) * side;
      let to = (top + row) * width + left;
      for (let column = 0; column < side; column++) pixels[to++] = this.table[(cells ? cells[from++] : 0) & 0xffff];
    }
  }
}

function name({ x, y, z }: L.Coords): string {
  return `${x},${y},${z}`;
}

function parse(block: string): [number, number, number] {
  return block.split(",").map(Number) as [number, number, number];
}
