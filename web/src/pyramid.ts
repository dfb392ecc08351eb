// Tiles with their zoom pyramid: 32 x 32 cells, then 16 x 16 of them pooled, down to one.
// Pooling lets the occupied win, then the free, so that no wall is lost when one zooms out.

export const TILE = 32;
export const LEVELS = 6; // 32, 16, 8, 4, 2, 1
export const OFFSET = [0, 1024, 1280, 1344, 1360, 1364];
export const CELLS = 1024;
export const SIZE = 1365;

export type Pool = (a: number, b: number, c: number, d: number) => number;
export type Tiles = Map<number, Int16Array>; // by key; CELLS long as they came, SIZE long with their pyramid

/** Where tiles are drawn from. */
export interface Source {
  get(key: number): Int16Array | undefined;
  keys(): Iterable<number>;
  size(): number;
}

const HALF = 1 << 20;
const SPAN = 1 << 21;

export function keyOf(ty: number, tx: number): number {
  return (ty + HALF) * SPAN + (tx + HALF);
}

export function placeOf(key: number): [ty: number, tx: number] {
  return [Math.floor(key / SPAN) - HALF, (key % SPAN) - HALF];
}

export const occupiedWins: Pool = (a, b, c, d) => {
  const most = Math.max(a, b, c, d);
  return most > 0 ? most : Math.min(a, b, c, d);
};

export const greatest: Pool = (a, b, c, d) => Math.max(a, b, c, d);

/**
 * A tile with its pooled levels; row 0 is south in all of them.
 *
 * If what is there of it is a coarser level, its cells stand in for the finer ones.
 */
export function pyramid(cells: ArrayLike<number>, pool: Pool, level = 0): Int16Array {
  const all = new Int16Array(SIZE);
  all.set(cells, OFFSET[level]);
  for (let finer = level - 1; finer >= 0; finer--) {
    const side = TILE >> finer;
    let to = OFFSET[finer];
    for (let row = 0; row < side; row++) {
      const from = OFFSET[finer + 1] + (row >> 1) * (side >> 1);
      for (let column = 0; column < side; column++) all[to++] = all[from + (column >> 1)];
    }
  }
  for (let coarser = level + 1; coarser < LEVELS; coarser++) {
    const side = TILE >> coarser;
    let to = OFFSET[coarser];
    for (let row = 0; row < side; row++) {
      let from = OFFSET[coarser - 1] + 4 * row * side;
      for (let column = 0; column < side; column++, from += 2) {
        all[to++] = pool(all[from], all[from + 1], all[from + 2 * side], all[from + 2 * side + 1]);
      }
    }
  }
  return all;
}
