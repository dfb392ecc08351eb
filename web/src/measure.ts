// A measuring line: click from point to point; a double click or Escape ends it.

import * as L from "leaflet";
import type { Store } from "./store";

export class Measure {
  active = false;
  private readonly points: L.LatLng[] = [];
  private readonly group = L.layerGroup();
  private readonly line = L.polyline([], { className: "measure", interactive: false, weight: 2, dashArray: "6 5" });

  constructor(
    private readonly map: L.Map,
    private readonly store: Store,
  ) {
    map.on("mousemove", (event: L.LeafletMouseEvent) => {
      if (this.active && this.points.length > 0) this.draw(event.latlng);
    });
    map.on("dblclick", () => this.active && this.toggle());
  }

  toggle(): void {
    if (this.active) {
      this.end();
      return;
    }
    this.active = true;
    this.points.length = 0;
    this.group.clearLayers().addTo(this.map);
    this.line.setLatLngs([]).addTo(this.group);
    this.map.getContainer().classList.add("measuring");
    this.map.doubleClickZoom.disable();
  }

  end(): void {
    this.active = false;
    this.group.remove();
    this.map.getContainer().classList.remove("measuring");
    this.map.doubleClickZoom.enable();
    document.querySelector('[data-tool="m"]')?.setAttribute("aria-pressed", "false");
  }

  point(at: L.LatLng): void {
    this.points.push(at);
    this.draw(at);
    L.circleMarker(at, { className: "measure", radius: 3, interactive: false }).addTo(this.group);
  }

  private draw(to: L.LatLng): void {
    const path = [...this.points, to];
    this.line.setLatLngs(path);
    const cell = (this.store.state?.cell_mm ?? 0) / 1000;
    let length = 0;
    for (let k = 1; k < path.length; k++) length += Math.hypot(path[k].lat - path[k - 1].lat, path[k].lng - path[k - 1].lng) * cell;
    this.line.unbindTooltip().bindTooltip(`${length.toFixed(2)} m`, { permanent: true, className: "measure-label", direction: "top" }).openTooltip(to);
  }
}
