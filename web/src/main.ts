// The page: a map of the swarm and a panel beside it. Everything comes from the observer's server and nobody else.

import "leaflet/dist/leaflet.css";
import "uplot/dist/uPlot.min.css";
import "./style.css";
import * as L from "leaflet";
import { Charts } from "./charts";
import { $, dot, make, seldom, told } from "./dom";
import { icon } from "./icons";
import { type Standing, follow } from "./feed";
import { Legend, VIEWS, type View } from "./legend";
import { Measure } from "./measure";
import { DARK, LIGHT, PALETTES, type PaletteName, confidenceTable, contestedTable, css, faintTable, mapTable, rgb, robotTable, shade, witnessTable } from "./palette";
import { Panel } from "./panel";
import { Placing } from "./place";
import { Robots } from "./robots";
import { FUSED } from "./state";
import { Store, bounds, contested, witnessed, without } from "./store";
import { TileLayer } from "./tile_layer";
import { TimelineBar } from "./timeline";
import { Derived } from "./derived";
import { inspect } from "./inspect";

const store = new Store();
const remembered = (name: string): string | null => {
  try {
    return localStorage.getItem(`orion-${name}`);
  } catch {
    return null;
  }
};
const remember = (name: string, value: string): void => {
  try {
    localStorage.setItem(`orion-${name}`, value);
  } catch {
    // a browser that keeps nothing
  }
};

// --- the map

const map = L.map("map", {
  crs: L.CRS.Simple,
  zoomControl: false,
  attributionControl: false,
  zoomSnap: 0.25,
  zoomDelta: 0.5,
  wheelPxPerZoomLevel: 120,
  minZoom: -8,
  maxZoom: 6,
  center: [0, 0],
  zoom: 1,
});
for (const [name, z] of [["overlays", 250], ["trails", 420], ["placing", 430]] as const) map.createPane(name).style.zIndex = String(z);
const base = new TileLayer({ className: "layer-map" }).addTo(map);
const over = new TileLayer({ className: "layer-view", pane: "overlays" });
const robotLayers = new Map<string, TileLayer>();
const shownLayers = new Set<string>();

let view: View = "map";
let palette: PaletteName = "paper";
let dark = false;
const paper = (): typeof LIGHT => (dark ? DARK : LIGHT);

const disagreement = new Derived(store, contested);
const witnesses = new Derived(store, witnessed);
const others = new Derived(store, (from, key) => without(from, placing.session!.session, key));

const robots = new Robots(map, store, () => css(paper().free), (session) => panel.reveal(session));
const placing = new Placing(map, store, () => draw());
const panel = new Panel(store, {
  shown: shownLayers,
  jump,
  toggle,
  place: (session) => placing.begin(session),
});
const legend = new Legend();
const measure = new Measure(map, store);
const charts = new Charts(store);
const timeline = new TimelineBar();

/** While a robot is placed it is the map that it is placed on, whatever was looked at before. */
const looked = (): View => (placing.session ? "map" : view);

/** Everything anew: another view, other colours, another set of robots in the map. */
function draw(): void {
  const shown = store.sessions.filter((each) => shownLayers.has(each.session));
  const faint = looked() === "disagreement" || shown.length > 0 || placing.session !== null;
  let source = store.source(FUSED);
  let table = faint ? faintTable(paper()) : mapTable(palette, paper());
  if (placing.session) {
    others.begin();
    source = others;
    table = mapTable("paper", paper());
  } else if (view === "confidence") table = confidenceTable();
  else if (view === "witness") {
    witnesses.begin();
    source = witnesses;
    table = witnessTable(store.sessions.map((each) => rgb(each.colour)), paper());
  }
  base.show(source, table);
  $("map").style.background = table[0] === 0 ? "" : css(shade(palette, paper(), 0.5)); // else seams show between canvases
  if (looked() === "disagreement") {
    disagreement.begin();
    over.show(disagreement, contestedTable());
    if (!map.hasLayer(over)) over.addTo(map);
  } else over.remove();
  for (const [session, layer] of robotLayers) {
    if (shown.some((each) => each.session === session)) continue;
    layer.remove();
    robotLayers.delete(session);
  }
  for (const session of shown) {
    let layer = robotLayers.get(session.session);
    if (!layer) {
      layer = new TileLayer({ className: `layer-robot layer-${session.session}`, pane: "overlays" });
      robotLayers.set(session.session, layer);
    }
    layer.show(store.source(session.session), robotTable(rgb(session.colour)));
    if (!map.hasLayer(layer)) layer.addTo(map);
  }
  legend.update(looked(), palette, paper(), faint);
  legend.count(looked(), disagreement);
  robots.update();
}

/** What has come in since the last frame on the screen. */
function refresh(): void {
  const changed = store.changed;
  store.changed = new Map();
  const fused = changed.get(FUSED) ?? new Set<number>();
  const all = new Set([...changed.values()].flatMap((keys) => [...keys]));
  if (placing.session) {
    if (changed.has(placing.session.session)) placing.redraw();
    others.forget(all);
    base.refresh(all);
  } else if (view === "witness") {
    witnesses.forget(all);
    base.refresh(all);
  } else base.refresh(fused);
  if (view === "disagreement") {
    disagreement.forget(all);
    over.refresh(all);
  }
  for (const [session, layer] of robotLayers) layer.refresh(changed.get(session) ?? new Set());
}

let summed = "";
let following = true; // the map as it grows, until somebody looks elsewhere
let followedSize = 0;
let waiting = false;

/** Show what has come in: the map with the next frame on the screen, words and numbers when there is time. */
function soon(): void {
  if (waiting) return;
  waiting = true;
  const now = (): void => {
    waiting = false;
    const set = store.sessions.map((each) => `${each.session}${each.summed}`).join();
    const other = set !== summed;
    summed = set;
    if (placing.session && !store.sessions.some((each) => each.session === placing.session!.session)) placing.end();
    if (following) followGrowth(); // first, so that nothing is painted in vain
    refresh();
    if (other) draw();
    else robots.update();
    timeline.update(store.state?.timeline ?? null);
    $("peers").hidden = Boolean(store.state?.timeline);
    words();
    mark();
  };
  if (document.hidden) setTimeout(now, 500);
  else requestAnimationFrame(now);
}

const words = seldom(200, () => {
  panel.update();
  charts.update();
  legend.count(looked(), disagreement);
});

/** For measurements (benchmarks/page.py): when the map was first seen, and when every cell of it was here. */
function mark(): void {
  const here = { "orion-first": store.tiles(FUSED).size > 0, "orion-whole": store.exact };
  for (const [name, so] of Object.entries(here)) {
    if (so && performance.getEntriesByName(name).length === 0) requestAnimationFrame(() => performance.mark(name));
  }
}

/** Keep the whole map in sight as it grows, without hurry; it is left as it is where it becomes smaller. */
const followGrowth = seldom(300, () => {
  const size = store.tiles(FUSED).size;
  if (size <= followedSize || placing.session || !following) return;
  followedSize = size;
  fit(false);
});

for (const event of ["pointerdown", "wheel"]) {
  $("map").addEventListener(event, () => (following = false), { capture: true, passive: true });
}

/** How many pixels the panel covers, from the right and from below. */
function covered(): [right: number, below: number] {
  const panel = $("panel");
  const bar = $("timeline").hidden ? 0 : $("timeline").offsetHeight + 8;
  if (panel.classList.contains("away")) return [0, bar];
  const size = panel.getBoundingClientRect();
  return matchMedia("(max-width: 720px)").matches ? [0, Math.min(size.height, innerHeight * 0.6) + bar] : [size.width + 12, bar];
}

/** Closer or farther, around the middle of what is not covered. */
function zoom(steps: number): void {
  following = false;
  const [right, below] = covered();
  const size = map.getSize();
  map.setZoomAround(L.point((size.x - right) / 2, (size.y - below) / 2), map.getZoom() + steps);
}

/** The whole map into the part of the window that the panel leaves free. */
function fit(animate = true): boolean {
  const box = bounds(store.tiles(FUSED));
  if (!box) return false;
  const [i0, j0, columns, rows] = box;
  const [right, below] = covered();
  map.fitBounds([[j0, i0], [j0 + rows, i0 + columns]], {
    paddingTopLeft: [24, 24],
    paddingBottomRight: [right + 24, below + 24],
    maxZoom: 4,
    animate,
  });
  return true;
}

function jump(session: string): void {
  const pose = store.sessions.find((each) => each.session === session)?.pose;
  following = false;
  if (!pose) return;
  const closer = Math.max(map.getZoom(), 2);
  const [right, below] = covered();
  map.setView(map.unproject(map.project(robots.at(pose), closer).add([right / 2, below / 2]), closer), closer);
}

function toggle(session: string): void {
  if (!shownLayers.delete(session)) shownLayers.add(session);
  draw();
  panel.update();
}

// --- what there is to choose

function choose(next: View): void {
  view = next;
  for (const button of $("views").querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.view === view));
  draw();
}

for (const [name, label] of Object.entries(VIEWS)) {
  $("views").append(make("button", { "data-view": name, onclick: () => choose(name as View) }, label));
}

function colours(name: PaletteName): void {
  palette = name;
  remember("palette", name);
  $<HTMLSelectElement>("palette").value = name;
  draw();
}

for (const [name, label] of Object.entries(PALETTES)) $("palette").append(make("option", { value: name }, label));
$("palette").addEventListener("change", () => colours($<HTMLSelectElement>("palette").value as PaletteName));

function theme(next: boolean, keep = true): void {
  dark = next;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  $("theme").replaceChildren(icon(dark ? "sun" : "moon"));
  if (keep) remember("theme", dark ? "dark" : "light");
  draw();
  charts.redraw();
}

const system = matchMedia("(prefers-color-scheme: dark)");
system.addEventListener("change", () => remembered("theme") ?? theme(system.matches, false));
$("theme").addEventListener("click", () => theme(!dark));

interface Tool {
  key: string;
  name: string;
  deed: () => void;
  on?: () => boolean;
}

const TOOLS: Tool[] = [
  { key: "+", name: "Closer", deed: () => zoom(0.5) },
  { key: "-", name: "Farther", deed: () => zoom(-0.5) },
  { key: "f", name: "Fit the whole map", deed: () => ((following = true), fit()) },
  { key: "t", name: "Trails", deed: () => ((robots.trails = !robots.trails), robots.update()), on: () => robots.trails },
  { key: "h", name: "Hits as points", deed: () => ((robots.hits = !robots.hits), robots.update()), on: () => robots.hits },
  { key: "m", name: "Measure", deed: () => measure.toggle(), on: () => measure.active },
];

const KEYS: [key: string, what: string, deed: () => void][] = [
  ...TOOLS.map((tool): [string, string, () => void] => [tool.key, tool.name, tool.deed]),
  ...Object.entries(VIEWS).map(([name, label], k): [string, string, () => void] => [String(k + 1), `View: ${label}`, () => choose(name as View)]),
  ["r", "Jump to the next robot", nextRobot],
  ["l", "Layers of all robots on or off", allLayers],
  ["p", "Next palette", () => colours(next(Object.keys(PALETTES) as PaletteName[], palette))],
  ["d", "Dark or light", () => theme(!dark)],
  ["b", "Panel on or off", () => $("panel").classList.toggle("away")],
  ["?", "These keys", help],
];

function next<T>(all: T[], now: T): T {
  return all[(all.indexOf(now) + 1) % all.length];
}

let visited = -1;
function nextRobot(): void {
  const there = store.sessions.filter((each) => each.pose);
  if (there.length === 0) return;
  visited = (visited + 1) % there.length;
  jump(there[visited].session);
  panel.reveal(there[visited].session);
}

function allLayers(): void {
  const all = store.sessions.map((each) => each.session);
  const on = all.some((session) => !shownLayers.has(session));
  shownLayers.clear();
  if (on) all.forEach((session) => shownLayers.add(session));
  draw();
  panel.update();
}

function help(): void {
  told(
    "Keys",
    make(
      "dl",
      { class: "keys" },
      ...KEYS.flatMap(([key, what]) => [make("dt", {}, make("kbd", {}, key)), make("dd", {}, what)]),
      make("dt", {}, make("kbd", {}, "esc")),
      make("dd", {}, "Leave measuring or placing"),
      ...(store.state?.timeline
        ? [make("dt", {}, make("kbd", {}, "space")), make("dd", {}, "Play or pause"), make("dt", {}, make("kbd", {}, "← →")), make("dd", {}, "Five seconds back or on; with shift half a minute")]
        : []),
    ),
    make("p", { class: "dim" }, "A click on a cell tells who saw it; a double click on a robot's name jumps to it; arrows pan."),
  );
}
$("help").addEventListener("click", help);

for (const tool of TOOLS) {
  const button = make("button", { title: `${tool.name} (${tool.key})`, "aria-label": tool.name, "data-tool": tool.key }, icon(tool.key));
  const tell = (): void => {
    if (tool.on) button.setAttribute("aria-pressed", String(tool.on()));
  };
  const deed = tool.deed;
  tool.deed = () => {
    deed();
    tell();
  };
  KEYS.find(([key]) => key === tool.key)![2] = tool.deed;
  button.addEventListener("click", tool.deed);
  tell();
  $("tools").append(button);
}

document.addEventListener("keydown", (event) => {
  const target = event.target as HTMLElement;
  if (event.ctrlKey || event.metaKey || event.altKey || $<HTMLDialogElement>("dialog").open) return;
  if (event.key === "Escape") {
    measure.end();
    placing.end();
    map.closePopup();
    return;
  }
  if (target.tagName === "SELECT" || (target instanceof HTMLInputElement && target.type !== "range")) return;
  if (placing.session) {
    const step = event.shiftKey ? 10 : 1;
    const nudge = { ArrowLeft: [-step, 0, 0], ArrowRight: [step, 0, 0], ArrowUp: [0, step, 0], ArrowDown: [0, -step, 0], "[": [0, 0, 1], "]": [0, 0, -1] }[event.key];
    if (nudge) {
      event.preventDefault();
      event.stopPropagation();
      placing.nudge(nudge[0], nudge[1], nudge[2]);
      return;
    }
  }
  if (timeline.key(event)) {
    event.preventDefault();
    event.stopPropagation(); // the map pans with arrows
    return;
  }
  const found = KEYS.find(([key]) => key === event.key);
  if (found) {
    event.preventDefault();
    event.stopPropagation(); // the map zooms with + and -
    found[2]();
  } else if (target === $("map") && event.key.startsWith("Arrow")) following = false; // it pans
}, true);

map.on("click", (event: L.LeafletMouseEvent) => {
  if (measure.active) measure.point(event.latlng);
  else if (!placing.session) void inspect(map, store, event.latlng, covered());
});
map.on("mousemove", (event: L.LeafletMouseEvent) => legend.point(store, event.latlng));
$("grip").addEventListener("click", () => $("panel").classList.toggle("tall"));

// --- what comes in

let standing: Standing = "connecting";

function stand(next: Standing): void {
  standing = next;
  const log = Boolean(store.state?.timeline);
  const [colour, word] = {
    connecting: ["var(--warn)", "connecting"],
    live: log ? ["var(--accent)", "a recorded run"] : ["var(--good)", "live"],
    lost: ["var(--bad)", "not connected"],
    ended: ["var(--dim)", "has ended"],
  }[standing];
  $("standing").replaceChildren(dot(colour), word);
  document.documentElement.dataset.standing = standing;
  $("banner").hidden = standing === "live" || standing === "connecting";
  $("banner").textContent = standing === "lost" ? "The observer cannot be reached. This is what it told last; trying again." : log ? "The log is closed. This is what was shown last." : "The swarm has ended. This is its last map.";
  timeline.enable(standing === "live");
  $("files").inert = standing === "ended" || standing === "lost";
}

const palettes = Object.keys(PALETTES) as PaletteName[];
palette = palettes.find((name) => name === remembered("palette")) ?? "paper";
$<HTMLSelectElement>("palette").value = palette;
theme(remembered("theme") === null ? system.matches : remembered("theme") === "dark", false);
choose("map");
follow(
  (frame) => {
    const log = Boolean(store.state?.timeline);
    store.take(frame);
    if (log !== Boolean(store.state?.timeline)) stand(standing);
    if (Object.keys(frame).length > 0) soon();
  },
  stand,
  () => {
    store.clear();
    followedSize = 0;
  },
);
