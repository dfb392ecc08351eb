// What lies over the map: trails, poses with heading and name, hits. In cells, as the map is.

import * as L from "leaflet";
import type { Store } from "./store";
import { type Session, radians } from "./state";

interface Marks {
  line: L.Polyline;
  edge: L.Polyline;
  marker: L.Marker;
  drawn: number;
  drawnAt: number;
  look: string;
}

export class Robots {
  private readonly marks = new Map<string, Marks>();
  private readonly renderer = L.canvas({ padding: 0.5, pane: "trails" } as L.RendererOptions);
  private readonly points: HitsLayer;
  private later: ReturnType<typeof setTimeout> | undefined;
  trails = true;
  hits = false;

  constructor(
    private readonly map: L.Map,
    private readonly store: Store,
    private readonly edge: () => string,
    private readonly pick: (session: string) => void,
  ) {
    this.points = new HitsLayer(store);
  }

  at([x, y]: number[]): L.LatLng {
    const cell = this.store.state?.cell_mm ?? 1;
    return L.latLng(y / cell, x / cell);
  }

  /** Draw again what has changed. */
  update(): void {
    const shown = this.store.sessions.filter((each) => each.pose);
    const ids = new Set(shown.map((each) => each.session));
    for (const [session, marks] of this.marks) {
      if (ids.has(session)) continue;
      marks.line.remove();
      marks.edge.remove();
      marks.marker.remove();
      this.marks.delete(session);
    }
    for (const session of shown) this.draw(session);
    if (this.hits) {
      if (!this.map.hasLayer(this.points)) this.points.addTo(this.map);
      this.points.draw();
    } else this.points.remove();
  }

  private draw(session: Session): void {
    const marks = this.marks.get(session.session) ?? this.begin(session);
    const trail = this.store.tracks.get(session.session)?.trail ?? [];
    const now = performance.now();
    // a long way takes long to draw: not with every step, but it is drawn even if nothing comes after it
    const rest = marks.drawnAt + Math.min(500, trail.length / 5) - now;
    if (trail.length > marks.drawn && rest > 0) {
      clearTimeout(this.later);
      this.later = setTimeout(() => this.update(), rest);
    } else if (trail.length !== marks.drawn) {
      const path = trail.map((pose) => this.at(pose));
      marks.line.setLatLngs(path);
      marks.edge.setLatLngs(path);
      marks.drawn = trail.length;
      marks.drawnAt = now;
    }
    const faint = this.trails ? (session.summed ? 1 : 0.35) : 0;
    const look = `${faint} ${this.edge()}`;
    if (look !== marks.look) {
      marks.look = look;
      marks.line.setStyle({ opacity: 0.95 * faint });
      marks.edge.setStyle({ opacity: 0.7 * faint, color: this.edge() });
    }
    const pose = session.pose!;
    marks.marker.setLatLng(this.at(pose));
    const element = marks.marker.getElement();
    if (element) {
      element.querySelector<SVGElement>("svg")!.style.transform = `rotate(${-radians(pose[2])}rad)`;
      element.classList.toggle("away", !session.live && !this.store.state?.timeline);
    }
  }

  private begin(session: Session): Marks {
    const common = { renderer: this.renderer, interactive: false, smoothFactor: 1.5, lineJoin: "round" as const };
    const edge = L.polyline([], { ...common, color: this.edge(), weight: 4.5 }).addTo(this.map);
    const line = L.polyline([], { ...common, color: session.colour, weight: 2.2 }).addTo(this.map);
    const icon = document.createElement("div");
    icon.className = "robot";
    icon.style.setProperty("--colour", session.colour);
    icon.innerHTML = '<svg viewBox="-12 -12 24 24" width="24" height="24"><path d="M11 0 L-7 7.5 L-3.5 0 L-7 -7.5 Z"/></svg>';
    const name = document.createElement("span");
    name.textContent = session.robot;
    icon.append(name);
    const marker = L.marker([0, 0], {
      icon: L.divIcon({ html: icon, className: "robot-icon", iconSize: [24, 24] }),
      title: session.robot,
      alt: session.robot,
      keyboard: false,
    }).addTo(this.map);
    marker.on("click", () => this.pick(session.session));
    const marks = { line, edge, marker, drawn: 0, drawnAt: -Infinity, look: "" };
    this.marks.set(session.session, marks);
    return marks;
  }
}

/** Hits as points, on one canvas that covers what is seen. */
class HitsLayer extends L.Layer {
  private canvas?: HTMLCanvasElement;
  private shown?: L.Map;

  constructor(private readonly store: Store) {
    super();
  }

  override onAdd(map: L.Map): this {
    this.shown = map;
    this.canvas = L.DomUtil.create("canvas", "hits leaflet-zoom-hide", map.getPane("trails"));
    map.on("moveend zoomend resize", this.draw, this);
    return this;
  }

  override onRemove(map: L.Map): this {
    map.off("moveend zoomend resize", this.draw, this);
    this.canvas?.remove();
    this.canvas = undefined;
    return this;
  }

  draw(): void {
    const [map, canvas] = [this.shown, this.canvas];
    if (!map || !canvas) return;
    const size = map.getSize();
    const scale = window.devicePixelRatio || 1;
    canvas.width = size.x * scale;
    canvas.height = size.y * scale;
    canvas.style.width = `${size.x}px`;
    canvas.style.height = `${size.y}px`;
    L.DomUtil.setPosition(canvas, map.containerPointToLayerPoint([0, 0]));
    const context = canvas.getContext("2d")!;
    context.scale(scale, scale);
    const cell = this.store.state?.cell_mm ?? 1;
    for (const session of this.store.sessions) {
      context.fillStyle = session.colour;
      const hits = this.store.tracks.get(session.session)?.hits ?? [];
      for (let k = 0; k < hits.length; k++) {
        const at = map.latLngToContainerPoint([hits[k][1] / cell, hits[k][0] / cell]);
        context.globalAlpha = 0.25 + (0.75 * (k + 1)) / hits.length;
        context.fillRect(at.x - 1.5, at.y - 1.5, 3, 3);
      }
    }
  }
}
