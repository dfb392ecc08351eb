// Correcting a start pose: a robot's own map is dragged and turned over the others' until the walls meet. What is seen
// is the result, near enough (cells are turned as a picture; the robot makes them anew from its scans). Then it is sent.

import * as L from "leaflet";
import { $, confirmed, make, post } from "./dom";
import { rgb, robotTable } from "./palette";
import { TILE, placeOf } from "./pyramid";
import { type Pose, type Session, TURN, degrees, radians } from "./state";
import { type Store, bounds } from "./store";

export class Placing {
  session: Session | null = null;
  private readonly old: number[] = [0, 0, 0];
  private pose: [x: number, y: number, yaw: number] = [0, 0, 0]; // metres, radians
  private canvas: HTMLCanvasElement | null = null;
  private box: [number, number, number, number] = [0, 0, 1, 1];
  private handle: L.Marker | null = null;
  private centre: L.Marker | null = null;

  constructor(
    private readonly map: L.Map,
    private readonly store: Store,
    private readonly changed: () => void,
  ) {
    map.on("move zoom zoomend viewreset", () => this.lay());
  }

  begin(session: Session): void {
    this.end();
    this.session = session;
    const from = session.sensed_from ?? [0, 0, 0];
    [this.old[0], this.old[1], this.old[2]] = [from[0] / 1000, from[1] / 1000, radians(from[2])];
    const now = session.start ?? from;
    this.pose = [now[0] / 1000, now[1] / 1000, radians(now[2])];
    this.canvas = make("canvas", { class: "placed cells" });
    this.paint();
    this.map.getPane("placing")!.append(this.canvas);
    this.drags(this.canvas);
    this.centre = this.mark("start-mark", "Drag to move", (at) => this.moveTo(at.lng, at.lat));
    this.handle = this.mark("turn-mark", "Drag to turn", (at) => this.turnTo(at.lng, at.lat));
    this.form();
    this.lay();
    this.changed();
  }

  end(): void {
    if (!this.session) return;
    this.session = null;
    this.canvas?.remove();
    this.centre?.remove();
    this.handle?.remove();
    this.canvas = this.centre = this.handle = null;
    $("place").hidden = true;
    this.changed();
  }

  /** The robot has more on its map now; a hand may be on the picture of it. */
  redraw(): void {
    this.paint();
    this.lay();
  }

  nudge(east: number, north: number, turn: number): void {
    const cell = (this.store.state?.cell_mm ?? 20) / 1000;
    this.set([this.pose[0] + east * cell, this.pose[1] + north * cell, this.pose[2] + (turn * Math.PI) / 180]);
  }

  private get cell(): number {
    return (this.store.state?.cell_mm ?? 1) / 1000;
  }

  private set(pose: [number, number, number]): void {
    this.pose = pose;
    this.lay();
    const [x, y, yaw] = this.quantised();
    const values = [x / 1000, y / 1000, degrees(yaw)];
    ["place-x", "place-y", "place-yaw"].forEach((id, k) => {
      const input = $<HTMLInputElement>(id);
      if (document.activeElement !== input) input.value = values[k].toFixed(k < 2 ? 3 : 2);
    });
  }

  private quantised(): Pose {
    const yaw = Math.round((this.pose[2] / (2 * Math.PI)) * TURN);
    return [Math.round(this.pose[0] * 1000), Math.round(this.pose[1] * 1000), ((yaw % TURN) + TURN) % TURN];
  }

  private moveTo(i: number, j: number): void {
    this.set([i * this.cell, j * this.cell, this.pose[2]]);
  }

  private turnTo(i: number, j: number): void {
    this.set([this.pose[0], this.pose[1], Math.atan2(j * this.cell - this.pose[1], i * this.cell - this.pose[0])]);
  }

  /** The robot's own map as a picture, a pixel a cell. */
  private paint(): void {
    const tiles = this.store.tiles(this.session!.session);
    this.box = bounds(tiles) ?? [0, 0, TILE, TILE];
    const [i0, j0, columns, rows] = this.box;
    const canvas = this.canvas!;
    [canvas.width, canvas.height] = [columns, rows];
    const table = robotTable(rgb(this.session!.colour));
    const image = new ImageData(columns, rows);
    const pixels = new Uint32Array(image.data.buffer);
    for (const [key, cells] of tiles) {
      const [ty, tx] = placeOf(key);
      const [left, bottom] = [tx * TILE - i0, ty * TILE - j0];
      if (left < 0 || bottom < 0 || left >= columns || bottom >= rows) continue;
      for (let k = 0; k < 1024; k++) {
        pixels[(rows - 1 - bottom - (k >> 5)) * columns + left + (k & 31)] = table[cells[k] & 0xffff];
      }
    }
    canvas.getContext("2d")!.putImageData(image, 0, 0);
  }

  /** Where a cell of the picture lies once the robot is placed anew, in cells. */
  private moved(i: number, j: number): L.LatLng {
    const [x, y] = [i * this.cell - this.old[0], j * this.cell - this.old[1]];
    const turn = this.pose[2] - this.old[2];
    const [c, s] = [Math.cos(turn), Math.sin(turn)];
    return L.latLng((this.pose[1] + s * x + c * y) / this.cell, (this.pose[0] + c * x - s * y) / this.cell);
  }

  private lay(): void {
    if (!this.session || !this.canvas) return;
    const [i0, j0, , rows] = this.box;
    const corner = this.map.latLngToLayerPoint(this.moved(i0, j0 + rows));
    const right = this.map.latLngToLayerPoint(this.moved(i0 + 1000, j0 + rows)).subtract(corner).divideBy(1000);
    const down = this.map.latLngToLayerPoint(this.moved(i0, j0 + rows - 1000)).subtract(corner).divideBy(1000);
    this.canvas.style.transform = `matrix(${right.x},${right.y},${down.x},${down.y},${corner.x},${corner.y})`;
    const start = L.latLng(this.pose[1] / this.cell, this.pose[0] / this.cell);
    this.centre?.setLatLng(start);
    const at = this.map.latLngToLayerPoint(start);
    const tip = at.add([74 * Math.cos(this.pose[2]), -74 * Math.sin(this.pose[2])]);
    this.handle?.setLatLng(this.map.layerPointToLatLng(tip));
  }

  private mark(name: string, title: string, drag: (at: L.LatLng) => void): L.Marker {
    const marker = L.marker([0, 0], {
      draggable: true,
      title,
      icon: L.divIcon({ className: name, iconSize: [22, 22] }),
      zIndexOffset: 2000,
    }).addTo(this.map);
    marker.on("drag", () => drag(marker.getLatLng()));
    marker.getElement()!.style.setProperty("--colour", this.session!.colour);
    return marker;
  }

  /** The picture itself can be dragged too. */
  private drags(canvas: HTMLCanvasElement): void {
    canvas.addEventListener("pointerdown", (down) => {
      if (down.button !== 0) return;
      down.stopPropagation();
      down.preventDefault();
      canvas.setPointerCapture(down.pointerId);
      this.map.dragging.disable();
      let last = this.map.mouseEventToLatLng(down);
      const move = (event: PointerEvent): void => {
        const at = this.map.mouseEventToLatLng(event);
        const [east, north] = [(at.lng - last.lng) * this.cell, (at.lat - last.lat) * this.cell];
        this.set([this.pose[0] + east, this.pose[1] + north, this.pose[2]]);
        last = at;
      };
      const up = (): void => {
        canvas.removeEventListener("pointermove", move);
        this.map.dragging.enable();
      };
      canvas.addEventListener("pointermove", move);
      canvas.addEventListener("pointerup", up, { once: true });
      canvas.addEventListener("pointercancel", up, { once: true });
    });
  }

  private form(): void {
    const session = this.session!;
    const field = (id: string, label: string, step: string): HTMLElement =>
      make("label", {}, label, make("input", { id, type: "number", step, oninput: () => this.typed() }));
    const section = $("place");
    section.replaceChildren(
      make("h2", {}, `Where ${session.robot} started`),
      make("p", { class: "dim" }, "Drag its map until the walls meet; drag the ring to turn it. Arrows nudge it, [ and ] turn it."),
      make("div", { class: "fields" }, field("place-x", "x, m", "0.01"), field("place-y", "y, m", "0.01"), field("place-yaw", "yaw, °", "0.5")),
      make(
        "div",
        { class: "row" },
        make("button", { id: "place-cancel", onclick: () => this.end() }, "Cancel"),
        make("button", { id: "place-back", onclick: () => this.set([this.old[0], this.old[1], this.old[2]]) }, "As it was"),
        make("button", { class: "primary", id: "place-send", onclick: () => void this.send() }, "Send..."),
      ),
    );
    section.hidden = false;
    this.set(this.pose);
    section.scrollIntoView({ block: "nearest" });
  }

  private typed(): void {
    const [x, y, yaw] = ["place-x", "place-y", "place-yaw"].map((id) => $<HTMLInputElement>(id).valueAsNumber);
    if ([x, y, yaw].every(Number.isFinite)) this.set([x, y, (yaw * Math.PI) / 180]);
  }

  private async send(): Promise<void> {
    const session = this.session!;
    const [x_mm, y_mm, yaw_turn16] = this.quantised();
    const words = ([x, y, yaw]: Pose): string => `x ${(x / 1000).toFixed(3)} m, y ${(y / 1000).toFixed(3)} m, yaw ${degrees(yaw).toFixed(2)}°`;
    const yes = await confirmed(
      `Correct the start pose of ${session.robot}?`,
      [
        `Now: ${session.start ? words(session.start) : "nobody knows it"}.`,
        `Then: ${words([x_mm, y_mm, yaw_turn16])}.`,
        "The robot publishes all that it has sensed anew from there, and every peer's map follows. Another correction can undo it.",
      ],
      "Correct it",
    );
    if (yes && (await post("start-pose", { robot: session.robot, x_mm, y_mm, yaw_turn16 }))) this.end();
  }
}
