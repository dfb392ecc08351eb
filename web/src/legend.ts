// What the colours mean, and what lies under the pointer.

import type * as L from "leaflet";
import { $, make } from "./dom";
import type { Derived } from "./derived";
import { type PaletteName, type Paper, type Rgb, confidenceRamp, contestedColour, css, probability, shade } from "./palette";
import { FUSED } from "./state";
import type { Store } from "./store";

export const VIEWS = { map: "Map", confidence: "Confidence", witness: "Who saw it", disagreement: "Disagreement" } as const;
export type View = keyof typeof VIEWS;

export class Legend {
  private readonly note = make("span", { class: "note" });
  private readonly under = make("span", { class: "under" });
  private counted = -Infinity;

  update(view: View, palette: PaletteName, paper: Paper, faint: boolean): void {
    const bar = (colour: (t: number) => Rgb, ...words: string[]): HTMLElement[] => {
      const strip = make("canvas", { width: "120", height: "1", class: "strip" });
      const context = strip.getContext("2d")!;
      for (let x = 0; x < 120; x++) {
        context.fillStyle = css(colour(x / 119));
        context.fillRect(x, 0, 1, 1);
      }
      return [make("span", {}, words[0]), strip, make("span", {}, words[1])];
    };
    const parts = {
      map: () => (faint ? [make("span", {}, "the map, and robots' own maps in their colours")] : bar((t) => shade(palette, paper, t), "free", "occupied")),
      confidence: () => bar(confidenceRamp, "one ray", "hundreds"),
      witness: () => [make("span", {}, "who saw a cell most; paler where several did")],
      disagreement: () => bar(contestedColour, "doubted", "contradicted"),
    }[view]();
    this.note.textContent = "";
    this.counted = -Infinity;
    $("legend").replaceChildren(...parts, this.note, this.under);
  }

  /** How much of it there is; once a second is enough. */
  count(view: View, disagreement: Derived): void {
    if (view !== "disagreement" || performance.now() - this.counted < 1000) return;
    this.counted = performance.now();
    const cells = disagreement.count();
    this.note.textContent = `${cells} cell${cells === 1 ? "" : "s"}`;
  }

  point(store: Store, at: L.LatLng): void {
    const cell = (store.state?.cell_mm ?? 0) / 1000;
    const value = store.evidence(FUSED, Math.floor(at.lng), Math.floor(at.lat));
    const p = value === 0 ? "unknown" : `p ${probability(value).toFixed(2)}`;
    this.under.textContent = `${(at.lng * cell).toFixed(2)}, ${(at.lat * cell).toFixed(2)} m  ${p}`;
  }
}
