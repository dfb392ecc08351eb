// Who saw this: a click on a cell asks the server, which has the exact evidence of every session.

import * as L from "leaflet";
import { dot, make, seconds } from "./dom";
import { probability } from "./palette";
import type { Store } from "./store";

interface Witness {
  session: string;
  robot: string;
  summed: boolean;
  evidence: number;
  seconds: number | null;
}

interface Cell {
  i: number;
  j: number;
  evidence: number;
  probability: number;
  witnesses: Witness[];
}

let asked = 0;

export async function inspect(map: L.Map, store: Store, at: L.LatLng, [right, below]: [number, number]): Promise<void> {
  const [i, j] = [Math.floor(at.lng), Math.floor(at.lat)];
  const size = (store.state?.cell_mm ?? 0) / 1000;
  const box = make("div", { class: "cell-box" });
  const mine = ++asked;
  let cell: Cell;
  try {
    cell = (await (await fetch(`api/cell?i=${i}&j=${j}`)).json()) as Cell;
  } catch {
    cell = fromHere(store, i, j);
  }
  if (mine !== asked) return; // another cell was clicked meanwhile
  const word = cell.evidence === 0 ? "unknown" : cell.probability > 0.65 ? "occupied" : cell.probability < 0.196 ? "free" : "not sure";
  box.append(
    make("h3", {}, word, make("span", {}, ` p = ${cell.probability.toFixed(3)}`)),
    make("p", { class: "dim" }, `cell ${i}, ${j} at (${(i * size).toFixed(2)}, ${(j * size).toFixed(2)}) m; evidence ${cell.evidence > 0 ? "+" : ""}${cell.evidence}`),
  );
  if (cell.witnesses.length === 0) box.append(make("p", {}, "Nobody has seen it."));
  else {
    box.append(
      make(
        "table",
        {},
        ...cell.witnesses.map((each) =>
          make(
            "tr",
            { class: each.summed ? "" : "out", title: each.summed ? "" : "not in the map", "data-robot": each.robot, "data-evidence": String(each.evidence) },
            make("td", {}, dot(store.sessions.find((session) => session.session === each.session)?.colour ?? "gray"), each.robot),
            make("td", { class: "number" }, `${each.evidence > 0 ? "+" : ""}${each.evidence}`),
            make("td", {}, each.evidence > 0 ? "occupied" : "free"),
            make("td", { class: "dim" }, each.seconds === null ? "" : each.seconds < 2 ? "just now" : `${seconds(each.seconds)} ago`),
          ),
        ),
      ),
    );
  }
  L.popup({ closeButton: false, className: "cell-popup", maxWidth: 320, autoPanPaddingTopLeft: [24, 24], autoPanPaddingBottomRight: [right + 24, below + 24] })
    .setLatLng([j + 0.5, i + 0.5])
    .setContent(box)
    .openOn(map);
}

/** What this page itself knows, when the server has gone. */
function fromHere(store: Store, i: number, j: number): Cell {
  const evidence = store.evidence("", i, j);
  const witnesses = store.sessions
    .map((each) => ({ session: each.session, robot: each.robot, summed: each.summed, evidence: store.evidence(each.session, i, j), seconds: null }))
    .filter((each) => each.evidence !== 0);
  return { i, j, evidence, probability: probability(evidence), witnesses };
}
