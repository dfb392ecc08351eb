// A layer that is made of others, tile by tile, when somebody looks and only then.

import { FUSED } from "./state";
import type { Store } from "./store";

export class Derived {
  private made = new Map<number, Int16Array | undefined>();

  constructor(
    private readonly store: Store,
    private readonly make: (store: Store, key: number) => Int16Array | undefined,
  ) {}

  /** Everything is to be made anew. */
  begin(): void {
    this.made.clear();
  }

  /** Some tiles are to be made anew. */
  forget(keys: Iterable<number>): void {
    for (const key of keys) this.made.delete(key);
  }

  get(key: number): Int16Array | undefined {
    if (!this.made.has(key)) this.made.set(key, this.make(this.store, key));
    return this.made.get(key);
  }

  keys(): Iterable<number> {
    return this.store.tiles(FUSED).keys();
  }

  size(): number {
    return this.store.tiles(FUSED).size;
  }

  /** How many cells of the whole map are not zero. */
  count(): number {
    let cells = 0;
    for (const key of this.keys()) {
      const tile = this.get(key);
      if (tile && tile[1364] !== 0) for (let k = 0; k < 1024; k++) if (tile[k] !== 0) cells++;
    }
    return cells;
  }
}
